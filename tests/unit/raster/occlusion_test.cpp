#include "raster/occlusion.h"

#include <gtest/gtest.h>

#include "../gaussians/paged_model.h"
#include "gaussians/portable.h"
#include "raster/rasterizer.h"
#include "scenes.h"

namespace splatbus::raster {
namespace {

using test::PagedModel;
using testing::TestScene;

/// A wall of several sheets at z = 0, a crowd before and behind it, some in an object's frame.
TestScene walled_crowd(std::size_t crowd_size = 12000) {
  constexpr std::size_t kSide = 80, kSheets = 4;
  TestScene crowd = testing::random_scene(testing::radiance_layout(0), crowd_size,
                                          {.spread = 3, .scale_low = 0.01F, .scale_high = 0.06F}, 5);
  TestScene scene(crowd.layout, crowd_size + kSheets * kSide * kSide);
  scene.state = crowd.state;
  for (std::size_t i = 0; i < crowd_size; ++i) {
    for (int c = 0; c < crowd.layout.channels(); ++c) scene.at(c, i) = crowd.at(c, i);
    scene.object_id[i] = crowd.object_id[i];
    if (scene.at(2, i) > 0 && i % 4 != 0) scene.at(2, i) -= 3;  // most are behind
  }
  for (std::size_t i = crowd_size; i < scene.count; ++i) {
    const std::size_t at = (i - crowd_size) % (kSide * kSide);
    scene.at(0, i) = 0.06F * (static_cast<float>(at % kSide) - 0.5F * kSide);
    scene.at(1, i) = 0.06F * (static_cast<float>(at / kSide) - 0.5F * kSide);
    scene.at(2, i) = 0.01F * static_cast<float>((i - crowd_size) / (kSide * kSide));
    for (int c = 3; c < 6; ++c) scene.at(c, i) = std::log(c == 5 ? 0.005F : 0.05F);
    scene.at(6, i) = 1;
    scene.at(10, i) = 7;
    scene.at(11, i) = 0.3F;
  }
  return scene;
}

TEST(Occlusion, LeavesOutWhatIsHiddenAndThePictureIsTheSame) {
  TestScene scene = walled_crowd();
  scene.state.objects.at(7).scale = 1.4F;
  PagedModel paged(scene.view(), 12, 1);
  const auto rasterizer = make_cpu_rasterizer(2);
  for (const glm::vec3 eye : {glm::vec3(0.3F, 0.2F, 2.5F), glm::vec3(-1.1F, 0.9F, 3.4F), glm::vec3(0, 0, 6)}) {
    Camera camera = look_at(eye, {0, 0, 0}, 90, 70, 0.9F);
    camera.cx += 3;
    Render all, some;
    rasterizer->forward(paged.bounded_view(), camera, scene.state, {}, all);
    Occlusion occlusion;
    rasterizer->occlusion(occlusion);
    std::vector<PageLook> before, after;
    const Image error(90, 70, 1);
    rasterizer->look_at_pages(error, before);
    rasterizer->forward(paged.bounded_view(), camera, scene.state, {.occlusion = &occlusion}, some);
    rasterizer->look_at_pages(error, after);
    EXPECT_EQ(all.color.data, some.color.data);
    EXPECT_EQ(all.alpha.data, some.alpha.data);
    ASSERT_EQ(before.size(), after.size()) << "nothing that shows is left out";
    // What it says of the thinner model is the same.
    Occlusion again;
    rasterizer->occlusion(again);
    EXPECT_EQ(again.depth_m, occlusion.depth_m);

    // Hidden pages are not even looked at: whatever is in them.
    PagedModel changed = paged;
    std::size_t left_out = 0;
    const FrustumCamera pinhole{camera.fx, camera.fy, camera.cx, camera.cy, 90, 70, camera.near_m, 0.3F, 1, 1};
    const math::Rigid rigid = portable(inverse(camera.world_from_camera));
    for (std::size_t r = 0; r < paged.ranges.size(); ++r) {
      if (paged.ranges[r].frame_id != kWorldFrame) continue;
      if (!occlusion.hides(pinhole, {rigid.rotation, rigid.translation, 1}, paged.bounds[r])) continue;
      ++left_out;
      for (std::uint32_t i = paged.ranges[r].first; i < paged.ranges[r].first + paged.ranges[r].count; ++i) {
        changed.memory[changed.view().offset(i) + 2 * kPageLanes] = 1;
      }
    }
    EXPECT_GT(left_out, 20U);
    GaussiansView view = changed.view();
    view.bounds = paged.bounds;
    rasterizer->forward(view, camera, scene.state, {.occlusion = &occlusion}, some);
    EXPECT_EQ(all.color.data, some.color.data);
    rasterizer->forward(view, camera, scene.state, {}, some);
    EXPECT_NE(all.color.data, some.color.data);
  }
}

TEST(Occlusion, WhereWhatHidFadesThePageIsBackAVisitLater) {
  TestScene scene = walled_crowd(1);
  scene.object_id[0] = 14;  // a page of its own
  scene.state.objects[14] = ObjectTransform();
  for (int c = 0; c < 3; ++c) scene.at(c, 0) = c == 2 ? -2.0F : 0.0F;
  PagedModel paged(scene.view(), 12, 1);
  const auto rasterizer = make_cpu_rasterizer(1);
  const Camera camera = look_at({0.3F, 0.2F, 2.5F}, {0, 0, 0}, 90, 70, 0.9F);
  Render picture, all;
  rasterizer->forward(paged.bounded_view(), camera, scene.state, {}, picture);
  Occlusion occlusion;
  rasterizer->occlusion(occlusion);
  paged.for_each([&](std::uint32_t i, std::size_t) {
    float& logit = paged.memory[paged.view().offset(i) + 10 * kPageLanes];
    logit = std::min(logit, -4.0F);
  });
  rasterizer->forward(paged.bounded_view(), camera, scene.state, {}, all);
  rasterizer->forward(paged.bounded_view(), camera, scene.state, {.occlusion = &occlusion}, picture);
  EXPECT_NE(picture.color.data, all.color.data);
  rasterizer->occlusion(occlusion);
  rasterizer->forward(paged.bounded_view(), camera, scene.state, {.occlusion = &occlusion}, picture);
  EXPECT_EQ(picture.color.data, all.color.data);
}

TEST(Occlusion, IsOfOnePlaceAndOneSceneOnly) {
  TestScene scene = walled_crowd();
  PagedModel paged(scene.view(), 12, 1);
  const auto rasterizer = make_cpu_rasterizer(1);
  const Camera camera = look_at({0.3F, 0.2F, 2.5F}, {0, 0, 0}, 90, 70, 0.9F);
  Render picture;
  rasterizer->forward(paged.bounded_view(), camera, scene.state, {}, picture);
  Occlusion occlusion;
  rasterizer->occlusion(occlusion);
  EXPECT_TRUE(occlusion.holds_for(camera, scene.state.objects));
  const Camera beside = look_at({2.6F, 0.2F, 0.6F}, {0, 0, 0}, 90, 70, 0.9F);
  EXPECT_FALSE(occlusion.holds_for(beside, scene.state.objects));
  Render with, without;
  rasterizer->forward(paged.bounded_view(), beside, scene.state, {.occlusion = &occlusion}, with);
  rasterizer->forward(paged.bounded_view(), beside, scene.state, {}, without);
  EXPECT_EQ(with.color.data, without.color.data);
  SceneState moved = scene.state;
  moved.objects.at(7).rigid.translation.x += 1;
  EXPECT_FALSE(occlusion.holds_for(camera, moved.objects));
}

TEST(Occlusion, HidesNothingWhereSomethingMayShow) {
  const FrustumCamera pinhole{100, 100, 32, 32, 64, 64, 0.1F, 0.3F, 1, 1};
  Occlusion occlusion{.camera = {}, .objects = {}, .tile_side = 8, .tiles_x = 8, .tiles_y = 8, .depth_m = {}};
  occlusion.depth_m.assign(64, 4.0F);
  const math::Similarity here{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, {0, 0, 0}, 1};
  const PageBounds page{{-0.1F, -0.1F, 5}, {0.1F, 0.1F, 6}, 0.01F};
  EXPECT_TRUE(occlusion.hides(pinhole, here, page));
  EXPECT_TRUE(occlusion.hides(pinhole, {here.rotation, {0, 0, 4}, 0.5F}, page));
  EXPECT_FALSE(occlusion.hides(pinhole, {here.rotation, {0, 0, 1}, 0.5F}, page)) << "at 3.5 m";
  EXPECT_FALSE(occlusion.hides(pinhole, here, {{-0.1F, -0.1F, 3.9F}, {0.1F, 0.1F, 6}, 0.01F})) << "in front";
  EXPECT_FALSE(occlusion.hides(pinhole, here, {{-0.1F, -0.1F, -1}, {0.1F, 0.1F, 6}, 0.01F})) << "about the camera";
  // Its means are within pixels 30 to 34; a Gaussian of 0.1 m reaches 3.33 * 0.1 * 141 / 5 = 9.4 further, and 3.4.
  occlusion.depth_m[4 * 8 + 6] = INFINITY;  // from 48 on
  EXPECT_TRUE(occlusion.hides(pinhole, here, page));
  EXPECT_TRUE(occlusion.hides(pinhole, here, {page.low, page.high, 0.1F}));
  EXPECT_FALSE(occlusion.hides(pinhole, here, {page.low, page.high, 0.15F}));
  occlusion.depth_m[4 * 8 + 3] = INFINITY;
  EXPECT_FALSE(occlusion.hides(pinhole, here, page));
}

}  // namespace
}  // namespace splatbus::raster

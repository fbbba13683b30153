// What pictures with depth say of Gaussians. The truth is a plane, an edge or the sky, put into the picture by hand.
#include "trainer/carving.h"

#include <gtest/gtest.h>

#include <cmath>
#include <glm/gtc/matrix_transform.hpp>

#include "device_pages.h"

namespace splatbus::trainer {
namespace kernels {
namespace {

constexpr std::uint32_t kSide = 64;
constexpr float kFocal_px = 64;

/// 64 x 64 pixels at the origin, looking along z; a pixel is 1/64 of the depth wide.
Camera camera() {
  Camera camera;
  camera.width = camera.height = kSide;
  camera.fx = camera.fy = kFocal_px;
  camera.cx = camera.cy = kSide / 2.0F;
  camera.near_m = 0.5F;
  camera.far_m = 50;
  return camera;
}

template <class DepthAt>
std::vector<float> depth_picture(DepthAt&& depth_at) {
  std::vector<float> depth;
  for (std::uint32_t row = 0; row < kSide; ++row) {
    for (std::uint32_t column = 0; column < kSide; ++column) depth.push_back(depth_at(column, row));
  }
  return depth;
}
std::vector<float> plane(float depth_m) {
  return depth_picture([&](auto, auto) { return depth_m; });
}

/// Of a Gaussian about pixel coordinates (u, v).
Verdict verdict(const std::vector<float>& depth, float u, float v, float z, float largest_m, float second_m) {
  const Camera c = camera();
  const DepthPicture picture{.fx = c.fx,
                             .fy = c.fy,
                             .cx = c.cx,
                             .cy = c.cy,
                             .near_m = c.near_m,
                             .far_m = c.far_m,
                             .width = static_cast<int>(c.width),
                             .height = static_cast<int>(c.height),
                             .depth = depth.data()};
  const float thin_m = 0.1F * second_m;
  const math::Vec3 at{(u - c.cx) / c.fx * z, (v - c.cy) / c.fy * z, z};
  // Whichever axes they lie along.
  const Verdict verdict = judge(picture, at, {std::log(largest_m), std::log(second_m), std::log(thin_m)});
  EXPECT_EQ(judge(picture, at, {std::log(thin_m), std::log(largest_m), std::log(second_m)}), verdict);
  EXPECT_EQ(judge(picture, at, {std::log(second_m), std::log(thin_m), std::log(largest_m)}), verdict);
  return verdict;
}

TEST(Carving, FreeInFrontSupportedAtAndHiddenBehindASurface) {
  const auto depth = plane(4);
  EXPECT_EQ(verdict(depth, 20.3F, 40.6F, 3, 0.03F, 0.03F), Verdict::Free);
  EXPECT_EQ(verdict(depth, 20.3F, 40.6F, 4, 0.03F, 0.03F), Verdict::Supported);
  EXPECT_EQ(verdict(depth, 20.3F, 40.6F, 5, 0.03F, 0.03F), Verdict::None);
}

TEST(Carving, TheMarginIsTheGaussiansExtentAndAPartOfItsDepth) {
  const auto depth = plane(4);
  // 3 x 0.1 m + 0.015 x 3.6 m = 0.354 m
  EXPECT_EQ(verdict(depth, 32, 32, 3.66F, 0.1F, 0.1F), Verdict::Supported);
  EXPECT_EQ(verdict(depth, 32, 32, 3.63F, 0.1F, 0.1F), Verdict::Free);
  // 3 x 0.1 m + 0.015 x 4.4 m = 0.366 m
  EXPECT_EQ(verdict(depth, 32, 32, 4.36F, 0.1F, 0.1F), Verdict::Supported);
  EXPECT_EQ(verdict(depth, 32, 32, 4.38F, 0.1F, 0.1F), Verdict::None);
}

TEST(Carving, TheMarginIsAPartOfTheDepthNearTheCameraToo) {
  // 3 x 1 mm + 0.015 x 0.6 m = 12 mm
  EXPECT_EQ(verdict(plane(0.6115F), 32, 32, 0.6F, 0.001F, 0.001F), Verdict::Supported);
  EXPECT_EQ(verdict(plane(0.6135F), 32, 32, 0.6F, 0.001F, 0.001F), Verdict::Free);
}

TEST(Carving, TheSkyIsInfinitelyFarAndNonsenseHides) {
  EXPECT_EQ(verdict(plane(0), 32, 32, 30, 0.5F, 0.5F), Verdict::Free);
  EXPECT_EQ(verdict(plane(INFINITY), 32, 32, 30, 0.5F, 0.5F), Verdict::Free);
  EXPECT_EQ(verdict(plane(NAN), 32, 32, 3, 0.05F, 0.05F), Verdict::None);
  EXPECT_EQ(verdict(plane(-1), 32, 32, 3, 0.05F, 0.05F), Verdict::None);
}

TEST(Carving, WhatThePictureCannotShowIsNotJudged) {
  const auto sky = plane(0);
  EXPECT_EQ(verdict(sky, 32, 32, 51, 0.9F, 0.9F), Verdict::None) << "beyond the far plane";
  EXPECT_EQ(verdict(sky, 32, 32, 0.4F, 0.01F, 0.01F), Verdict::None) << "before the near plane";
  EXPECT_EQ(verdict(sky, 32, 32, -2, 0.1F, 0.1F), Verdict::None) << "behind the camera";
  EXPECT_EQ(verdict(sky, 64.5F, 32, 2, 0.1F, 0.1F), Verdict::None);
  EXPECT_EQ(verdict(sky, 32, -0.5F, 2, 0.1F, 0.1F), Verdict::None);
  EXPECT_EQ(verdict(sky, 63.5F, 0.5F, 2, 0.1F, 0.1F), Verdict::Free);
  EXPECT_EQ(verdict(sky, 32, 32, NAN, 0.1F, 0.1F), Verdict::None);
  EXPECT_EQ(verdict(sky, 32, 32, 2, NAN, NAN), Verdict::None);
  // At 2 m a pixel is 31 mm wide; a wire of a tenth of that falls between pixel centres.
  EXPECT_EQ(verdict(sky, 32, 32, 2, 0.2F, 0.0008F), Verdict::None);
  EXPECT_EQ(verdict(sky, 32, 32, 2, 0.2F, 0.0011F), Verdict::Free);
}

TEST(Carving, SilhouettesStay) {
  // An object at 2 m covers columns below 32.
  const auto depth = depth_picture([](auto column, auto) { return column < 32 ? 2.0F : 6.0F; });
  for (const float u : {20.0F, 31.5F, 32.9F}) {
    EXPECT_EQ(verdict(depth, u, 32, 2, 0.02F, 0.02F), Verdict::Supported) << u;
    EXPECT_EQ(verdict(depth, u, 32, 3, 0.02F, 0.02F), Verdict::None) << u << ": hidden, or at the very edge";
    EXPECT_EQ(verdict(depth, u, 32, 1, 0.01F, 0.01F), Verdict::Free) << u << ": in front of both";
  }
  EXPECT_EQ(verdict(depth, 33.5F, 32, 2, 0.02F, 0.02F), Verdict::Free) << "beside it";
  EXPECT_EQ(verdict(depth, 36.5F, 32, 3, 0.02F, 0.02F), Verdict::Free);
  // Two standard deviations of 0.15 m are 9.6 pixels at 2 m: it reaches over the object's edge from 8 pixels beside it.
  EXPECT_EQ(verdict(depth, 40, 32, 2, 0.15F, 0.15F), Verdict::None);
  EXPECT_EQ(verdict(depth, 44, 32, 2, 0.15F, 0.15F), Verdict::Free);
}

TEST(Carving, CornersStay) {
  // An object at 2 m covers a quarter of the picture.
  for (const bool right : {false, true}) {
    for (const bool low : {false, true}) {
      const auto depth = depth_picture(
          [&](auto column, auto row) { return (column >= 32) == right && (row >= 32) == low ? 2.0F : 6.0F; });
      const float x = right ? -1 : 1, y = low ? -1 : 1;  // away from it
      EXPECT_EQ(verdict(depth, 32 + 0.5F * x, 32 + 0.5F * y, 2, 0.02F, 0.02F), Verdict::Supported);
      EXPECT_EQ(verdict(depth, 32 + 1.5F * x, 32 + 1.5F * y, 2, 0.02F, 0.02F), Verdict::Free);
      EXPECT_EQ(verdict(depth, 32 + 8 * x, 32 + 8 * y, 2, 0.15F, 0.15F), Verdict::None) << "reaches over it";
      EXPECT_EQ(verdict(depth, 32 + 12 * x, 32 + 12 * y, 2, 0.15F, 0.15F), Verdict::Free);
    }
  }
}

class CarvingOn : public KernelsOn {
 protected:
  static void put(Pages& pages, std::uint32_t i, float x, float y, float z, float opacity_logit = 2) {
    pages.at(ParameterLayout::kMean, i) = x;
    pages.at(ParameterLayout::kMean + 1, i) = y;
    pages.at(ParameterLayout::kMean + 2, i) = z;
    for (std::uint32_t axis = 0; axis < 3; ++axis) pages.at(ParameterLayout::kLogScale + axis, i) = std::log(0.03F);
    pages.at(ParameterLayout::kOpacityLogit, i) = opacity_logit;
  }
  static std::vector<PageBounds> bounds_of(Pages& pages) {
    std::vector<PageBounds> bounds;
    for (const IndexRange& range : pages.ranges) {
      PageBounds& of = bounds.emplace_back();
      for (std::uint32_t i = range.first; i < range.first + range.count; ++i) {
        include(of, {pages.at(0, i), pages.at(1, i), pages.at(2, i)}, std::log(0.03F));
      }
    }
    return bounds;
  }
  static TrainingViewPtr view(const device::Buffer<float>& depth, std::uint64_t frame, ObjectTransforms objects = {},
                              const Rigid& world_from_camera = {}) {
    TrainingView view;
    view.camera = camera();
    view.camera.world_from_camera = world_from_camera;
    view.scene.objects = std::move(objects);
    view.frame = frame;
    view.memory = GetParam();
    view.depth = Pixels<float>(std::shared_ptr<const float>(std::shared_ptr<void>(), depth.data()), depth.size());
    return std::make_shared<const TrainingView>(std::move(view));
  }
};

constexpr CarveLimits kLimits{.votes = 3, .min_opacity_logit = -4};

/// Frames whose instants differ.
constexpr std::uint64_t kFrames[] = {30, 60, 90, 120, 150, 180};

/// What a carver does with a sequence of pictures.
class CarverOn : public CarvingOn {
 protected:
  struct Picture {
    const device::Buffer<float>* depth;
    std::uint64_t frame;
    ObjectTransforms objects;
    Rigid world_from_camera;
  };
  /// Indices that are marked after the pictures.
  static std::vector<std::uint32_t> marked(Pages& pages, const std::vector<Picture>& pictures) {
    std::vector<std::uint32_t> found;
    const auto bounds = pages.place(bounds_of(pages));
    auto dead = pages.place(std::vector<std::uint8_t>(pages.indices(), 7));
    pages.run([&](auto stream, const auto& gaussians) {
      Carver carver(stream);
      carver.follow(pages.indices(), device::Buffer<IndexRange>(stream), {});
      for (const Picture& p : pictures) {
        carver.look(view(*p.depth, p.frame, p.objects, p.world_from_camera), gaussians, bounds.data(), kLimits, 0);
      }
      stream.wait();  // all that was looked at is done
      const std::size_t waiting = carver.carvable(1);
      const std::size_t count = carver.mark(gaussians, kLimits.votes, dead.data());
      EXPECT_GE(waiting, count);
      EXPECT_EQ(carver.carvable(1), 0U) << "counts anew";
      const std::vector<std::uint8_t> marks = dead.to_host();
      for (std::uint32_t i = 0; i < pages.indices(); ++i) {
        if (marks[i] == 1) found.push_back(i);
      }
      EXPECT_EQ(found.size(), count);
    });
    return found;
  }
};

TEST_P(CarverOn, AWallThatOpensGoesAndWhatLiesBehindItStays) {
  Pages pages = make_pages({{0, 600}, {2 * kPageLanes, 500}});
  std::vector<std::uint32_t> wall;
  for (std::uint32_t i = 0; i < 600; ++i) {  // every other one belongs to the wall, 1 m before the surface
    const float x = static_cast<float>(i % 24) / 12 - 1, y = static_cast<float>(i / 24) / 12 - 1;
    put(pages, i, x, y, i % 2 == 0 ? 3 : 4);
    if (i % 2 == 0) wall.push_back(i);
  }
  for (std::uint32_t i = 0; i < 500; ++i) put(pages, 2 * kPageLanes + i, 0, 0, 6);  // hidden
  put(pages, 0, 0, 0, 3, -5);                                                       // nobody sees it
  wall.erase(wall.begin());
  const auto behind = pages.place(plane(4));
  EXPECT_EQ(marked(pages, {{&behind, kFrames[0]}, {&behind, kFrames[1]}, {&behind, kFrames[2]}}), wall);
  EXPECT_TRUE(marked(pages, {{&behind, kFrames[0]}, {&behind, kFrames[1]}}).empty()) << "too few";
}

TEST_P(CarverOn, AnInstantHasOneVote) {
  Pages pages = make_pages({{0, 1}});
  put(pages, 0, 0, 0, 3);
  const auto free = pages.place(plane(4)), wall = pages.place(plane(3));
  const std::vector<std::uint32_t> none, it{0};
  const Rigid beside{.translation = {0.1F, 0, 0}};
  EXPECT_EQ(marked(pages, {{&free, 30}, {&free, 30, {}, beside}, {&free, 30}, {&free, 60}}), none);
  EXPECT_EQ(marked(pages, {{&free, 30}, {&free, 30, {}, beside}, {&free, 60}, {&free, 90}}), it);
  EXPECT_EQ(marked(pages, {{&free, 30}, {&free, 60}, {&wall, 90}, {&free, 120}, {&free, 150}}), none)
      << "it was seen in between";
  EXPECT_EQ(marked(pages, {{&free, 30}, {&free, 60}, {&wall, 90}, {&free, 120}, {&free, 150}, {&free, 180}}), it);
  EXPECT_EQ(marked(pages, {{&free, 30}, {&wall, 60}, {&free, 60}, {&free, 90}, {&free, 120}}), none)
      << "one of an instant's pictures sees it";
  EXPECT_EQ(marked(pages, {{&free, 30}, {&free, 60}, {&free, 90}, {&wall, 120}}), none) << "in time";
}

TEST_P(CarverOn, InstantsAreToldApart) {
  Pages pages = make_pages({{0, 1}});
  put(pages, 0, 0, 0, 3);
  const auto free = pages.place(plane(4));
  for (std::uint64_t pace = 1; pace <= 64; ++pace) {
    std::vector<Picture> pictures;
    for (std::uint64_t n = 0; n < 3; ++n) pictures.push_back({&free, 1000 + n * pace});
    EXPECT_EQ(marked(pages, pictures).size(), 1U) << pace;
  }
  const auto wall = pages.place(plane(3));
  std::vector<Picture> pictures;
  for (std::uint64_t n = 0; n < 100; ++n) pictures.push_back({&wall, n});
  for (std::uint64_t n = 100; n < 103; ++n) pictures.push_back({&free, n});
  EXPECT_EQ(marked(pages, pictures).size(), 1U) << "after many";
}

TEST_P(CarverOn, ObjectsAreJudgedWhereTheyAreInThatVeryPicture) {
  Pages pages = make_pages({{0, 2}, {kPageLanes, 2, 7}, {2 * kPageLanes, 2, 9}});
  for (std::uint32_t page = 0; page < 3; ++page) {
    put(pages, page * kPageLanes, 0, 0, 1);
    put(pages, page * kPageLanes + 1, 0.2F, 0, 1.5F);
  }
  const auto free = pages.place(plane(4));
  const std::uint32_t p1 = kPageLanes, p2 = 2 * kPageLanes;
  // Object 7 stands on the surface at 4 m with its second Gaussian; 9 is in no scene.
  ObjectTransforms objects{{3, {}}, {7, Rigid{.translation = {0, 0, 2.5F}}}};
  const std::vector<std::uint32_t> expected{0, 1, p1};
  EXPECT_EQ(marked(pages, {{&free, 30, objects}, {&free, 60, objects}, {&free, 90, objects}}), expected);
  // It moves: never in front of the surface, and once out of the picture.
  objects.at(7).rigid.translation = {0, 0, 3};
  ObjectTransforms aside = objects;
  aside.at(7).rigid.translation = {40, 0, 0};
  // Turned by 180 degrees about y, what lies at z = 1 lies at -1: on the surface from 5 m.
  ObjectTransforms turned = objects;
  turned.at(7) = Rigid{.rotation = {0, 0, 1, 0}, .translation = {0, 0, 5}};
  EXPECT_EQ(marked(pages, {{&free, 30, objects}, {&free, 60, aside}, {&free, 90, turned}, {&free, 120, aside}}),
            (std::vector<std::uint32_t>{0, 1}));
  ObjectTransforms back = objects;
  back[9] = {};
  EXPECT_EQ(marked(pages, {{&free, 30, back}, {&free, 60, back}, {&free, 90, back}}),
            (std::vector<std::uint32_t>{0, 1, p2, p2 + 1}));
  // From x = 6, looking along -x at the same surface 4 m away, everything of the world's frame is hidden.
  const Rigid pose{.rotation = glm::angleAxis(glm::radians(-90.0F), glm::vec3(0, 1, 0)), .translation = {6, 0, 0}};
  objects.at(7).rigid.translation = {4, 0, -1};
  EXPECT_EQ(marked(pages, {{&free, 30, objects, pose}, {&free, 60, objects, pose}, {&free, 90, objects, pose}}),
            (std::vector<std::uint32_t>{p1, p1 + 1}));
}

TEST_P(CarverOn, AnObjectsScaleGoesForPlacesAndSizes) {
  Pages pages = make_pages({{0, 2, 7}});
  put(pages, 0, 0, 0, 0.2F);   // ten times as large: 2 m before the camera, 0.3 m of standard deviation
  put(pages, 1, 0, 0, 0.32F);  // reaches the surface
  const auto free = pages.place(plane(4));
  ObjectTransforms objects{{7, {}}};
  objects.at(7).scale = 10;
  EXPECT_EQ(marked(pages, {{&free, 30, objects}, {&free, 60, objects}, {&free, 90, objects}}),
            std::vector<std::uint32_t>{0});
  // As they are, both are nearer than the camera sees.
  objects.at(7).scale = 1;
  EXPECT_TRUE(marked(pages, {{&free, 30, objects}, {&free, 60, objects}, {&free, 90, objects}}).empty());
  // Beside the picture's axis a page is passed over by its bounds alone: 40 m to the side, 8 m away.
  put(pages, 0, 4, 0, 0.2F);
  put(pages, 1, 4, 0, 0.2F);
  objects.at(7).scale = 10;
  EXPECT_TRUE(marked(pages, {{&free, 30, objects}, {&free, 60, objects}, {&free, 90, objects}}).empty());
  put(pages, 0, 0.9F, 0, 2.9F);
  objects.at(7) = Rigid{.translation = {0, 0, 0}};
  objects.at(7).scale = 1.2F;
  put(pages, 1, 0.9F, 0, 2.9F);
  EXPECT_EQ(marked(pages, {{&free, 30, objects}, {&free, 60, objects}, {&free, 90, objects}}).size(), 2U);
}

TEST_P(CarverOn, TheCamerasPoseCounts) {
  Pages pages = make_pages({{0, 2}});
  put(pages, 0, 2, 0, 0);
  put(pages, 1, 3.5F, 0, 0);
  const auto depth = pages.place(plane(3));
  // At x = 6, looking along -x.
  const Rigid pose{.rotation = glm::angleAxis(glm::radians(-90.0F), glm::vec3(0, 1, 0)), .translation = {6, 0, 0}};
  ASSERT_NEAR((pose * glm::vec3(0, 0, 3)).x, 3, 1e-5F);
  EXPECT_EQ(marked(pages, {{&depth, 30, {}, pose}, {&depth, 60, {}, pose}, {&depth, 90, {}, pose}}),
            std::vector<std::uint32_t>{1});
}

TEST_P(CarverOn, StandingFollowsTheModelsChanges) {
  Pages pages = make_pages({{0, 4}, {kPageLanes, 2}});
  for (const std::uint32_t i : {0U, 1U, 2U, 3U, kPageLanes, kPageLanes + 1}) put(pages, i, 0, 0, 3);
  const auto free = pages.place(plane(4));
  const auto bounds = pages.place(bounds_of(pages));
  auto dead = pages.place(std::vector<std::uint8_t>(pages.indices()));
  const auto fresh = pages.place(std::vector<IndexRange>{{1, 2}});
  const auto from = pages.place(std::vector<std::uint32_t>{0}), to = pages.place(std::vector<std::uint32_t>{2});
  pages.run([&](auto stream, const auto& gaussians) {
    Carver carver(stream);
    carver.follow(pages.indices(), device::Buffer<IndexRange>(stream), {});
    const auto look = [&](std::uint64_t frame) {
      carver.look(view(free, frame), gaussians, bounds.data(), kLimits, 0);
    };
    look(30);
    look(60);
    carver.follow(pages.indices(), fresh, {.count = 1, .from = from.data(), .to = to.data()});
    look(90);
    EXPECT_EQ(carver.mark(gaussians, kLimits.votes, dead.data()), 5U) << "all but the fresh one";
  });
  EXPECT_EQ(dead.to_host()[1], 0);
  EXPECT_EQ(dead.to_host()[2], 1) << "which was moved there";
}

INSTANTIATE_TEST_SUITE_P(Devices, CarverOn, testing::Values(Device::Cpu, Device::Cuda),
                         [](const auto& device) { return std::string(name_of(device.param)); });

}  // namespace
}  // namespace kernels
}  // namespace splatbus::trainer

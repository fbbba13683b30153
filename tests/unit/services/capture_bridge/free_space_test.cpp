#include "capture-bridge/free_space.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "analytic_scene.h"
#include "capture-bridge/blindness.h"
#include "capture-bridge/input_rigs.h"

namespace splatbus::capture_bridge::test {
namespace {

constexpr float kClearance_m = 0.3F;

FreeSpace seen_from(const AnalyticScene& scene, const glm::vec3& place) {
  const auto cameras = FreeSpace::cameras(place, 64, 0.02F, 100);
  FreeSpace::Depth depth_m;
  for (std::size_t face = 0; face < cameras.size(); ++face) {
    const InputView view = scene.render(cameras.at(face));
    for (std::size_t i = 0; i < view.pixels(); ++i) {
      const float depth = view.object_id[i] == 0 ? 0 : project(view.camera, glm::vec3(view.position[i])).z;
      depth_m.at(face).push_back(depth);
    }
  }
  return {cameras, std::move(depth_m)};
}

/// Unit, all about.
std::vector<glm::vec3> directions(int count) {
  std::vector<glm::vec3> all;
  for (int i = 0; i < count; ++i) {
    const float y = 1 - (2 * static_cast<float>(i) + 1) / static_cast<float>(count);
    const float angle = 2.3999632F * static_cast<float>(i);
    all.push_back({std::sqrt(1 - y * y) * std::cos(angle), y, std::sqrt(1 - y * y) * std::sin(angle)});
  }
  return all;
}

Viewer at(const glm::vec3& eye, const glm::vec3& target) {
  return {.camera = look_at(eye, target, 64, 64, 1)};
}

TEST(FreeSpace, IsWhatRaysFindInEveryDirection) {
  AnalyticScene scene;
  scene.boxes = room({0, 0, 0}, true);
  const glm::vec3 place(-0.4F, 1.5F, 1.1F);
  const FreeSpace free = seen_from(scene, place);
  int near = 0;
  for (const glm::vec3& direction : directions(500)) {
    const auto hit = scene.cast(place, direction);
    const float expected = hit ? hit->distance : std::numeric_limits<float>::infinity();
    // It may be nearer by what stands within a pixel's angle, never farther by more than a pixel's depth.
    EXPECT_LE(free.distance(direction), 1.05F * expected) << direction.x << ' ' << direction.y << ' ' << direction.z;
    if (free.distance(direction) >= 0.9F * expected) ++near;
  }
  EXPECT_GT(near, 425);
}

TEST(FreeSpace, IsWithoutEndWhereNothingIsSeen) {
  const FreeSpace free = seen_from({}, {0, 1.6F, 0});
  EXPECT_TRUE(std::isinf(free.distance({0, 1, 0})));
  EXPECT_NEAR(free.distance({0, -1, 0}), 1.6F, 0.02F);
  EXPECT_EQ(free.reachable({3, 40, -7}, kClearance_m), glm::vec3(3, 40, -7));
  EXPECT_TRUE(free.sees({3, 40, -7}));
  EXPECT_FALSE(free.sees({0.1F, -0.1F, 0}));
  EXPECT_NEAR(glm::distance(free.reachable({0, -1, 0}, kClearance_m), glm::vec3(0, 1.6F - 0.8F * 1.6F + 0.3F, 0)), 0,
              0.02F);
}

/// Who stands in a room has no input camera in a wall, behind one, under the floor or behind a closed door, and not all
/// of them at one place.
TEST(FreeDome, StandsWhereItCanSee) {
  for (const bool open_door : {false, true}) {
    AnalyticScene scene;
    scene.boxes = room({0, 0, 0}, open_door);
    for (const glm::vec3& ahead : directions(24)) {
      const glm::vec3 eye(0.5F, 1.5F, -0.3F);
      const Viewer viewer = at(eye, eye + ahead);
      const FreeSpace free = seen_from(scene, eye);
      const DomePlace place = dome_place({}, &viewer, &free, 0);
      const auto cameras = free_dome({.cameras = 24, .size = 16}, place, &free, kClearance_m);
      float farthest = 0;
      for (const Camera& camera : cameras) {
        const glm::vec3 stands = camera.world_from_camera.translation;
        farthest = std::max(farthest, glm::distance(stands, eye));
        const glm::vec3 way = stands - eye;
        const auto hit = scene.cast(eye, glm::normalize(way));
        EXPECT_TRUE(!hit || hit->distance > glm::length(way)) << "hidden from the viewer";
        for (const AnalyticScene::Box& box : scene.boxes) EXPECT_FALSE(box.holds(stands));
        EXPECT_GT(stands.y, 0);
        if (open_door) continue;
        EXPECT_LT(std::max({std::abs(stands.x), std::abs(stands.z), stands.y - 0.6F}), 2) << "beyond the walls";
      }
      EXPECT_GT(farthest, 0.5F);
      const auto hit = scene.cast(eye, ahead);
      EXPECT_LE(glm::distance(place.centre, eye), 1.05F * (hit ? std::min(3.4F, hit->distance) : 3.4F));
    }
  }
}

TEST(FreeDome, StandsAsItWouldWhereAllIsFree) {
  const FreeSpace free = seen_from({}, {0, 1.6F, 3.4F});
  const DomeOptions dome{.cameras = 12, .size = 16, .radius_m = 2};
  const DomePlace place{.centre = {0, 0.5F, 1}};
  const auto tested = free_dome(dome, place, &free, kClearance_m);
  const auto untested = free_dome(dome, place, nullptr, kClearance_m);
  int same = 0;
  for (std::size_t i = 0; i < tested.size(); ++i) same += tested[i] == untested[i] ? 1 : 0;
  EXPECT_GE(same, 10) << "but for those low over the floor, or behind the ball";
}

/// What a low thing hides is seen from behind all the same, from higher up.
TEST(FreeDome, LooksOverWhatHides) {
  AnalyticScene scene;
  scene.boxes = {{{-2, 0, -1.2F}, {2, 1, -1}}};
  const glm::vec3 eye(0, 1.6F, 2);
  const FreeSpace free = seen_from(scene, eye);
  const DomeOptions dome{.cameras = 100, .size = 16, .radius_m = 2};
  const DomePlace place{.centre = {0, 0.3F, 0}};
  const auto tested = free_dome(dome, place, &free, kClearance_m);
  const auto untested = free_dome(dome, place, nullptr, kClearance_m);
  int behind = 0;
  for (std::size_t i = 0; i < tested.size(); ++i) {
    const glm::vec3 wished = untested[i].world_from_camera.translation,
                    stands = tested[i].world_from_camera.translation;
    if (wished.z > -1.4F || free.sees(wished)) continue;
    ++behind;
    EXPECT_LT(stands.z, -1.2F);
    EXPECT_NEAR(glm::distance(stands, place.centre), 2, 1e-3F);
    EXPECT_TRUE(free.sees(stands));
  }
  EXPECT_GE(behind, 4);
}

/// In a room the cameras together see all of its walls, not only what the viewer looks at.
TEST(FreeDome, InARoomAlsoLooksBack) {
  AnalyticScene scene;
  scene.boxes = room({0, 0, 0}, false);
  const Viewer viewer = at({0, 1.5F, 0.5F}, {0, 1.4F, -2});
  const FreeSpace free = seen_from(scene, viewer.position());
  const DomePlace place = dome_place({}, &viewer, &free, 0);
  int back = 0, ahead = 0;
  for (const Camera& camera : free_dome({.cameras = 24, .size = 16}, place, &free, kClearance_m)) {
    const glm::vec3 axis = camera.world_from_camera.rotation * glm::vec3(0, 0, 1);
    (axis.z > 0 ? back : ahead) += 1;
  }
  EXPECT_GE(back, 4);
  EXPECT_GE(ahead, 8);
}

/// One input camera sees all that the viewer will see: the ceiling over him, and what a door shows of the next room.
TEST(EyeCamera, SeesWhatTheViewerWillSee) {
  AnalyticScene scene;
  scene.boxes = room({0, 0, 0}, true);
  Viewer viewer = at({0, 1.5F, 0.5F}, {0.3F, 2.1F, -2});
  viewer.camera.width = 160;
  viewer.camera.height = 90;
  viewer.camera.cx = 80;
  viewer.camera.cy = 45;
  viewer.camera.fx = viewer.camera.fy = 70;
  viewer.velocity_m_s = {0, 0, -1.4F};
  const FreeSpace free = seen_from(scene, viewer.position());
  const Camera eye = eye_camera({.size = {64, 48}}, {.lead_s = 0.5F}, viewer, &free, kClearance_m);
  const glm::vec3 will_be = viewer.position() + 0.5F * viewer.velocity_m_s;
  EXPECT_LT(glm::distance(eye.world_from_camera.translation, will_be), 1e-4F);
  EXPECT_EQ(eye.width, 64U);
  for (const glm::vec2 corner : {glm::vec2(0, 0), glm::vec2(160, 0), glm::vec2(0, 90), glm::vec2(160, 90)}) {
    const glm::vec3 ray((corner.x - 80) / 70, (corner.y - 45) / 70, 1);
    const glm::vec3 world = viewer.camera.world_from_camera.rotation * ray;
    const glm::vec3 seen = glm::inverse(eye.world_from_camera.rotation) * world;
    EXPECT_LT(std::abs(eye.fx * seen.x / seen.z), 0.5F * 64);
    EXPECT_LT(std::abs(eye.fy * seen.y / seen.z), 0.5F * 48);
  }
  // Through no wall.
  viewer.velocity_m_s = {9, 0, 0};
  EXPECT_TRUE(
      free.sees(eye_camera({.size = 64}, {.lead_s = 0.5F}, viewer, &free, kClearance_m).world_from_camera.translation));
}

/// Wherever a viewer looks level, some camera shows it.
TEST(EyeCamera, OthersLookAllAbout) {
  for (const auto& [about, target_m] : {std::pair(3U, 1.2F), {5U, 1.2F}, {3U, -2.0F}, {5U, -2.0F}}) {
    const Viewer viewer = at({0, 1.5F, 0}, {0.3F, target_m, -2});
    const Camera eye = eye_camera({.size = 64}, {}, viewer, nullptr, kClearance_m);
    std::vector<Camera> eyes = cameras_about(eye, nullptr, about);
    ASSERT_EQ(eyes.size(), about);
    eyes.push_back(eye);
    for (int degrees = 0; degrees < 360; degrees += 5) {
      const float angle = glm::radians(static_cast<float>(degrees));
      const glm::vec3 ray(std::cos(angle), 0, std::sin(angle));
      EXPECT_TRUE(std::ranges::any_of(eyes,
                                      [&](const Camera& camera) {
                                        const glm::vec3 seen = glm::inverse(camera.world_from_camera.rotation) * ray;
                                        return seen.z > 0 && std::abs(camera.fx * seen.x / seen.z) < 32 &&
                                               std::abs(camera.fy * seen.y / seen.z) < 32;
                                      }))
          << degrees << " of " << about;
    }
  }
}

/// In the open they would show the sky, which the dome can do without.
TEST(EyeCamera, OthersLookWhereThereIsSomething) {
  AnalyticScene scene;
  scene.boxes = room({0, 0, 0}, true);
  const Viewer viewer = at({0, 1.5F, 0}, {0, 1.2F, -2});
  const FreeSpace inside = seen_from(scene, viewer.position());
  const Camera eye = eye_camera({.size = 64}, {}, viewer, &inside, kClearance_m);
  EXPECT_EQ(cameras_about(eye, &inside, 5).size(), 5U);
  scene.boxes.clear();
  const FreeSpace open = seen_from(scene, viewer.position());
  EXPECT_TRUE(cameras_about(eye, &open, 5).empty());
}

TEST(DomePlace, LeadsButNotThroughWalls) {
  const DomePlacement options{.focus_m = 3, .lead_s = 0.5F};
  Viewer viewer = at({0, 1.5F, 0}, {0, 1.5F, -1});
  EXPECT_LT(glm::distance(dome_place(options, &viewer, nullptr, 0).centre, glm::vec3(0, 1.5F, -3)), 1e-4F);
  viewer.velocity_m_s = {4, 0, 0};
  EXPECT_LT(glm::distance(dome_place(options, &viewer, nullptr, 0).centre, glm::vec3(2, 1.5F, -3)), 1e-4F);
  AnalyticScene scene;
  scene.boxes = room({0, 0, 0}, false);
  const FreeSpace free = seen_from(scene, viewer.position());
  const glm::vec3 centre = dome_place(options, &viewer, &free, 0).centre;
  // 0.8 * 2 m to the side, then towards 3 m ahead of that as far as the wall at 2 m.
  EXPECT_NEAR(centre.x, 1.6F * 2 / 3, 0.1F);
  EXPECT_NEAR(centre.z, -2, 0.1F);
}

TEST(DomePlace, RisesWithTheViewerAndLooksForNothingInTheSky) {
  const DomePlacement options{.focus_m = 3};
  const FreeSpace free = seen_from({}, {0, 1.6F, 0});
  const Viewer up = at({0, 1.6F, 0}, {0, 3, -1});
  EXPECT_NEAR(dome_place(options, &up, &free, 0).centre.y, 1.6F, 1e-4F);
  EXPECT_GT(dome_place(options, &up, nullptr, 0).centre.y, 3);
  AnalyticScene stairs;
  stairs.boxes = {{{-1, 0, -3}, {1, 1, 1}}};  // a step of a metre
  const Viewer below = at({0, 1.6F, 2}, {0, 1.6F, 1});
  const Viewer above = at({0, 2.6F, 0}, {0, 2.6F, -1});
  const FreeSpace free_below = seen_from(stairs, below.position()), free_above = seen_from(stairs, above.position());
  EXPECT_NEAR(
      dome_place(options, &above, &free_above, 0).centre.y - dome_place(options, &below, &free_below, 0).centre.y, 1,
      1e-3F);
}

TEST(Blindness, IsWhatMostPixelsShowRightBeforeTheCamera) {
  AnalyticScene scene;
  scene.boxes = {{{-5, 0, -1}, {5, 5, -0.5F}}};
  BlindnessTest test(Device::Cpu);
  const auto from = [&](float metres) {
    return scene.render(look_at({0, 2, metres - 0.5F}, {0, 2, -1}, 32, 24, 0.8F));
  };
  EXPECT_TRUE(test.is_blind(from(0.15F), 0.2F));
  EXPECT_FALSE(test.is_blind(from(0.25F), 0.2F));
  EXPECT_FALSE(test.is_blind(from(0.15F), 0.1F));
  const InputView half = scene.render(look_at({4.98F, 2, -0.4F}, {4.98F, 2, -1}, 32, 24, 0.8F));
  std::size_t shown = 0;
  for (const std::uint32_t id : half.object_id) shown += id != 0 ? 1 : 0;
  ASSERT_GT(2 * shown, half.pixels());
  EXPECT_TRUE(test.is_blind(half, 0.2F));
  const InputView less = scene.render(look_at({5.02F, 2, -0.4F}, {5.02F, 2, -1}, 32, 24, 0.8F));
  EXPECT_FALSE(test.is_blind(less, 0.2F)) << "the sky is far";
}

}  // namespace
}  // namespace splatbus::capture_bridge::test

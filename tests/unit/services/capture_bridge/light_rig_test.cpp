#include "capture-bridge/light_rig.h"

#include <gtest/gtest.h>

#include <map>
#include <set>

namespace splatbus::capture_bridge {
namespace {

constexpr LightRigOptions kOptions{.depth_size = 1024, .source_size = 256, .cascades = 3, .extent_m = 40};

/// A camera over the whole scene.
Camera over(float side_m) {
  Camera camera{.role = CameraRole::Light, .width = 1024, .height = 1024};
  camera.fx = camera.fy = 1024 / side_m;
  return camera;
}

std::vector<CameraRequest> of_light(const std::vector<CameraRequest>& all, std::uint32_t light_id) {
  std::vector<CameraRequest> some;
  std::ranges::copy_if(all, std::back_inserter(some),
                       [&](const auto& request) { return request.light_id == light_id; });
  return some;
}

TEST(LightRig, AToySceneHasOneMapOfAllOfIt) {
  LightRig rig;
  const auto before = rig.requests(kOptions, {}, {});
  rig.saw(0, 0, over(15));
  const auto after = rig.requests(kOptions, {}, {3, 0, 0});
  for (const auto& all : {before, after}) {
    ASSERT_EQ(all.size(), 1U);
    EXPECT_EQ(all[0].extent_m, 0);
    EXPECT_EQ(all[0].light_map, 0U);
    EXPECT_EQ(all[0].camera.width, 1024U);
    EXPECT_EQ(rig.maps_with(0, 0, all[0].camera.id), 1U);
  }
  EXPECT_EQ(before[0].camera, after[0].camera) << "nothing to ask for anew";
}

TEST(LightRig, ALargeSceneHasTexelsUnderFiveCentimetresNearTheViewer) {
  LightRig rig;
  const auto whole = rig.requests(kOptions, {}, {}).front();
  rig.saw(0, 0, over(283));
  const glm::vec3 viewer(70, 1, -40);
  const auto all = rig.requests(kOptions, {}, viewer);
  ASSERT_EQ(all.size(), 3U);
  for (std::uint32_t map = 0; map < 3; ++map) {
    EXPECT_EQ(all[map].light_map, map);
    EXPECT_EQ(rig.maps_with(0, map, all[map].camera.id), 3U);
    EXPECT_EQ(rig.maps_with(0, (map + 1) % 3, all[map].camera.id), 0U) << "what was asked for before as another map";
    EXPECT_NEAR(static_cast<float>(all[map].camera.width) / all[map].camera.fx, map < 2 ? all[map].extent_m : 12,
                1e-3F);
  }
  EXPECT_EQ(all[0].camera.world_from_camera.translation, viewer);
  EXPECT_LT(all[0].extent_m / 1024, 0.05F);
  EXPECT_EQ(all[1].extent_m, 4 * all[0].extent_m);
  EXPECT_EQ(all[2].extent_m, 0);
  EXPECT_EQ(all[2].camera.id, whole.camera.id) << "it stays what it was, but for its place in the order";
}

TEST(LightRig, CascadesFollowTheViewerBeyondAPartOfTheirSize) {
  LightRig rig;
  (void)rig.requests(kOptions, {}, {});
  rig.saw(0, 0, over(283));
  const auto at_start = rig.requests(kOptions, {}, {});
  const auto nearby = rig.requests(kOptions, {}, {4.9F, 0, 0});
  EXPECT_EQ(nearby[0].camera, at_start[0].camera);
  const auto farther = rig.requests(kOptions, {}, {5.1F, 0, 0});
  EXPECT_EQ(farther[0].camera.world_from_camera.translation.x, 5.1F);
  EXPECT_EQ(farther[1].camera, at_start[1].camera) << "four times as large";
}

TEST(LightRig, ASceneThatGrowsAndShrinksALittleChangesNothing) {
  LightRig rig;
  (void)rig.requests(kOptions, {}, {});
  const auto maps = [&](float side_m) {
    const auto now = rig.requests(kOptions, {}, {}).size();
    rig.saw(0, static_cast<std::uint32_t>(now) - 1, over(side_m));
    return rig.requests(kOptions, {}, {}).size();
  };
  EXPECT_EQ(maps(58), 1U);
  EXPECT_EQ(maps(63), 2U);
  EXPECT_EQ(maps(58), 2U);
  EXPECT_EQ(maps(63), 2U);
  EXPECT_EQ(maps(48), 1U);
  rig.saw(0, 0, over(300));
  (void)rig.requests(kOptions, {}, {});
  rig.saw(0, 0, over(40));  // the finest cascade says nothing of the scene
  EXPECT_EQ(rig.requests(kOptions, {}, {}).size(), 3U);
}

TEST(LightRig, EveryLightThatCastsAShadowHasItsMaps) {
  LightRig rig;
  Light light;
  light.sources = {{.id = 4, .kind = LightKind::Point},
                   {.id = 5, .kind = LightKind::Spot},
                   {.id = 6, .kind = LightKind::Directional},
                   {.id = 4'000'000'000, .kind = LightKind::Point},
                   {.id = 4'000'000'001, .kind = LightKind::Point, .casts_shadow = false}};
  const auto all = rig.requests(kOptions, light, {});
  EXPECT_EQ(of_light(all, 0).size(), 1U);
  EXPECT_EQ(of_light(all, 4).size(), 6U);
  EXPECT_EQ(of_light(all, 4)[5].light_map, 5U);
  EXPECT_EQ(of_light(all, 4)[5].camera.width, 256U);
  EXPECT_EQ(of_light(all, 5).size(), 1U);
  EXPECT_EQ(of_light(all, 6).size(), 1U);
  EXPECT_EQ(of_light(all, 6)[0].camera.width, 1024U);
  EXPECT_EQ(of_light(all, 4'000'000'000).size(), 6U);
  EXPECT_EQ(all.size(), 15U);
  std::set<std::uint32_t> cameras;
  for (const CameraRequest& request : all) cameras.insert(request.camera.id);
  EXPECT_EQ(cameras.size(), all.size()) << "an id of its own for each";

  light.sources.erase(light.sources.begin());
  const auto fewer = rig.requests(kOptions, light, {});
  EXPECT_EQ(fewer.size(), 9U);
  EXPECT_EQ(of_light(fewer, 5)[0].camera.id, of_light(all, 5)[0].camera.id) << "those that stay are not asked for anew";
  EXPECT_EQ(rig.maps_with(4, 0, of_light(all, 4)[0].camera.id), 0U);
}

TEST(FaultOf, NamesLightCamerasThatAreNotTheLights) {
  Light light{.sun_direction = glm::normalize(glm::vec3(1, 2, 0)), .sun_irradiance = glm::vec3(1)};
  light.sources = {{.id = 4, .kind = LightKind::Point, .position = {1, 2, 3}},
                   {.id = 5, .kind = LightKind::Spot, .position = {1, 2, 3}, .direction = {0, -1, 0}},
                   {.id = 6, .casts_shadow = false}};
  Camera sun = over(20);
  sun.world_from_camera = look_at(light.sun_direction, {0, 0, 0}, 1, 1, 1).world_from_camera;
  EXPECT_EQ(fault_of(light, 0, 0, sun), "");
  EXPECT_NE(fault_of(light, 7, 0, sun), "");
  EXPECT_NE(fault_of(light, 6, 0, sun), "");
  Camera bad = sun;
  bad.fx = 1e9F;
  EXPECT_NE(fault_of(light, 0, 0, bad).find("degenerate"), std::string::npos) << "no extent";
  bad = sun;
  bad.world_from_camera.rotation = glm::quat(1, 0, 0, 0);
  EXPECT_NE(fault_of(light, 0, 0, bad).find("degenerate"), std::string::npos) << "it looks elsewhere";
  Light night = light;
  night.sun_irradiance = {};
  EXPECT_EQ(fault_of(night, 0, 0, bad), "") << "a sun that is out has no direction";

  Camera face = over(2);
  face.near_m = 0.1F;
  face.world_from_camera.translation = {1, 2, 3};
  EXPECT_EQ(fault_of(light, 4, 0, face), "");
  EXPECT_NE(fault_of(light, 5, 0, face), "") << "not along the spot's axis";
  face.world_from_camera.rotation = glm::angleAxis(1.5707964F, glm::vec3(1, 0, 0));
  EXPECT_EQ(fault_of(light, 5, 0, face), "");
  face.near_m = 0;
  EXPECT_NE(fault_of(light, 4, 0, face), "");
  face.near_m = 0.1F;
  face.world_from_camera.translation.x = 1.5F;
  EXPECT_NE(fault_of(light, 4, 0, face).find("light 4, map 0"), std::string::npos);
}

}  // namespace
}  // namespace splatbus::capture_bridge

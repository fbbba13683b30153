// Which version of the scene another engine's frame shows.
#include "capture-bridge/scene_versions.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "gaussians/player.h"

namespace splatbus::capture_bridge::test {
namespace {

SceneState scene(std::uint64_t version, float x_m) {
  SceneState state;
  state.version = version;
  state.light.sun_irradiance = glm::vec3(1);
  state.light.sources = {{.id = 3, .position = {0, 2, 0}, .depth_version = version}};
  state.light.sun_depth_version = version;
  state.light.generation = version;
  state.objects[7] = Rigid{.translation = {x_m, 0, 0}};
  return state;
}

TEST(SceneVersions, WhatEqualsAStateIsOfItsVersionWhateverEachEngineCountsForItself) {
  SceneVersions versions(10);
  EXPECT_EQ(versions.newest().state->version, 10U);
  EXPECT_EQ(versions.showing(SceneState{}), nullptr);  // nobody has shown that
  versions.add(scene(11, 1));
  versions.seen(4, 0.4);
  versions.add(scene(12, 2));
  SceneState other = scene(900, 1);
  other.objects[kPlayerId] = Rigid{.translation = {5, 5, 5}};
  const SceneVersion* const found = versions.showing(other);
  ASSERT_NE(found, nullptr);
  EXPECT_EQ(found->state->version, 11U);
  EXPECT_EQ(found->frame, 4U);
  EXPECT_EQ(found->time_s, 0.4);
  // A state that returns is a version of its own, with depth maps of its own.
  versions.add(scene(13, 1));
  EXPECT_EQ(versions.showing(other)->state->version, 13U);
}

TEST(SceneVersions, WhatDiffersInAnythingThatShowsIsOfNone) {
  SceneVersions versions(10);
  versions.add(scene(11, 1));
  const std::vector<std::function<void(SceneState&)>> changes = {
      [](SceneState& s) { s.objects[7].rigid.translation.x = std::nextafter(1.0F, 2.0F); },
      [](SceneState& s) { s.objects[7].scale = 2; },
      [](SceneState& s) { s.objects[7].emissive = true; },
      [](SceneState& s) { s.objects.erase(7); },
      [](SceneState& s) { s.objects[8] = {}; },
      [](SceneState& s) { s.light.sun_irradiance.x = 2; },
      [](SceneState& s) {
        s.light.sun_direction = {1, 0, 0};
      },
      [](SceneState& s) { s.light.ambient_sh[3].y = 0.1F; },
      [](SceneState& s) { s.light.background.z = 0.1F; },
      [](SceneState& s) { s.light.sources[0].position.x = 0.1F; },
      [](SceneState& s) { s.light.sources.clear(); },
  };
  ASSERT_NE(versions.showing(scene(1, 1)), nullptr);
  for (std::size_t i = 0; i < changes.size(); ++i) {
    SceneState state = scene(1, 1);
    changes[i](state);
    EXPECT_EQ(versions.showing(state), nullptr) << i;
  }
}

TEST(SceneVersions, TheLastOnesAreKnown) {
  SceneVersions versions(0);
  for (std::uint64_t version = 1; version <= SceneVersions::kMost + 3; ++version) {
    versions.add(scene(version, static_cast<float>(version)));
  }
  EXPECT_EQ(versions.showing(scene(1, 3)), nullptr);
  ASSERT_NE(versions.showing(scene(1, 4)), nullptr);
  EXPECT_EQ(versions.showing(scene(1, 4))->state->version, 4U);
}

}  // namespace
}  // namespace splatbus::capture_bridge::test

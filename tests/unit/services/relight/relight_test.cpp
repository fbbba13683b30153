#include "relight/relight.h"

#include <gtest/gtest.h>

#include <map>

#include "relight_fixture.h"
#include "wire/system_generated.h"

namespace splatbus::relight {
namespace {

using test::RelightTest;

TEST_F(RelightTest, FollowsModelLightAndObjects) {
  publish_model(1);
  publish_depth(1, -2.0F);
  EXPECT_EQ(visibility(1, 1), (std::vector<float>{1, 0, 1}));
  publish_depth(2, 2.0F);
  EXPECT_EQ(visibility(1, 2), (std::vector<float>{1, 0, 0})) << "the object has moved under the roof";
  publish_model(2, 2);
  EXPECT_EQ(visibility(2, 2), (std::vector<float>{1, 0}));
}

/// A picture's version is answered with its own map and transforms, though a newer one has come meanwhile.
TEST_F(RelightTest, EveryPicturedVersionIsComputed) {
  publish_model(1);
  publish_depth(9, -2.0F);
  ASSERT_EQ(visibility(1, 9), (std::vector<float>{1, 0, 1}));
  publish_depth(10, -2.0F);
  publish_depth(11, 2.0F);
  publish_depth(12, -2.0F);
  publish_picture(scene(11, 2.0F));
  publish_picture(scene(10, -2.0F));
  std::map<std::uint64_t, std::vector<float>> found;
  while (found.size() < 3 && !HasFailure()) {
    const Relit relit = next_visibility();
    found[relit.scene_version] = relit.of_gaussian;
  }
  EXPECT_EQ(found[10], (std::vector<float>{1, 0, 1}));
  EXPECT_EQ(found[11], (std::vector<float>{1, 0, 0}));
  EXPECT_EQ(found[12], (std::vector<float>{1, 0, 1}));
}

TEST_F(RelightTest, AnotherMapOfTheSameSceneAndAModelThatBeginsAnewAreFollowed) {
  publish_model(5);
  publish_depth(1, -2.0F);
  ASSERT_EQ(visibility(5, 1), (std::vector<float>{1, 0, 1}));
  publish_depth(1, -2.0F, true, 2.0F);  // the roof is beyond x = 2 in it
  EXPECT_EQ(visibility(5, 1), (std::vector<float>{1, 1, 1}));
  publish_model(2);
  EXPECT_EQ(visibility(2, 1), (std::vector<float>{1, 1, 1})) << "a trainer without the model before it";
}

/// Another replica's pages are left to it, and taken back when it ends.
TEST_F(RelightTest, TwoReplicasShareThePages) {
  publish_model(1);
  publish_depth(1, -2.0F);
  ASSERT_EQ(visibility(1, 1), (std::vector<float>{1, 0, 1}));
  const bus::Publisher other(connect("relight-2"));
  const auto beat = [&](wire::ServiceState state) {
    other.publish(topics::kHeartbeat, {.latch_key = "relight-2"}, [&](auto& builder, auto header) {
      return wire::CreateHeartbeatDirect(builder, header, "relight", 1, state);
    });
  };
  beat(wire::ServiceState::Running);
  std::vector<std::uint32_t> pages;
  (void)next_visibility([&](const wire::RelightVisibility& body) {
    if (body.parts() != 2) return false;
    EXPECT_EQ(body.part(), 0U) << "by name";
    EXPECT_EQ(body.page_indices(), kPageLanes);
    pages.assign(body.pages()->begin(), body.pages()->end());
    return true;
  });
  // By the hashes of page and name, computed apart (tests/unit/services/relight/page_shares_test.cpp says what they
  // do).
  std::vector<std::uint32_t> own;
  PageShares shares("relight");
  {
    flatbuffers::FlatBufferBuilder builder;
    const auto header = wire::CreateHeaderDirect(builder, "Liveness/1", "bus");
    const std::vector<flatbuffers::Offset<wire::Node>> nodes{
        wire::CreateNodeDirect(builder, "relight-2", "relight", 1, 1, wire::ServiceState::Running, true)};
    builder.Finish(wire::CreateLivenessDirect(builder, header, &nodes));
    shares.take(*flatbuffers::GetRoot<wire::Liveness>(builder.GetBufferPointer()));
  }
  for (const std::uint32_t index : index_) {
    const std::uint32_t page = index / kPageLanes;
    if (shares.owns(page) && (own.empty() || own.back() != page)) own.push_back(page);
  }
  EXPECT_EQ(pages, own);
  beat(wire::ServiceState::Stopping);
  const Relit whole = next_visibility([](const wire::RelightVisibility& body) { return body.parts() == 0; });
  EXPECT_EQ(whole.of_gaussian, (std::vector<float>{1, 0, 1}));
}

constexpr std::uint32_t kLamp = 5;

LightSource lamp(std::uint64_t depth_version) {
  return {.id = kLamp, .position = {0, 2, 0}, .intensity = glm::vec3(1), .range_m = 9, .depth_version = depth_version};
}

/// Until the last face has come there is none of the version, though the sun's map is there; then it has a row a light.
TEST_F(RelightTest, AVersionWaitsForAllMapsOfAllItsLights) {
  publish_model(1);
  publish_depth(1, -2.0F);
  ASSERT_EQ(visibility(1, 1), (std::vector<float>{1, 0, 1}));
  sources = {lamp(70), {.id = 6, .casts_shadow = false, .position = {0, 1, 0}}};
  const SceneState state = scene(3, -2.0F);
  publish_picture(state);
  publish_depth(3, -2.0F);
  for (std::uint8_t face = 0; face < 5; ++face) publish_face(state, kLamp, face, 8);
  sources.clear();
  publish_depth(2, -2.0F);
  publish_picture(scene(2, -2.0F));
  EXPECT_EQ(next_visibility().scene_version, 2U) << "what is whole goes first";
  publish_face(state, kLamp, 5, 8);
  const Relit relit = next_visibility();
  EXPECT_EQ(relit.scene_version, 3U);
  EXPECT_EQ(relit.light_ids, (std::vector<std::uint32_t>{0, kLamp, 6}));
  EXPECT_EQ(relit.of_gaussian, (std::vector<float>{1, 0, 1}));
  EXPECT_EQ(relit.of_sources.at(0), (std::vector<float>{1, 1, 1}));
  EXPECT_EQ(relit.of_sources.at(1), (std::vector<float>{1, 1, 1})) << "it casts no shadow";
}

/// A light's maps hold for as long as its depth version: another scene needs no new ones. Another depth version's are
/// others, whichever comes first.
TEST_F(RelightTest, MapsBelongToADepthVersion) {
  publish_model(1);
  publish_depth(1, -2.0F);
  ASSERT_EQ(visibility(1, 1), (std::vector<float>{1, 0, 1}));
  sources = {lamp(70)};
  const SceneState first = scene(3, -2.0F);
  publish_depth(3, -2.0F);
  for (std::uint8_t face = 0; face < 6; ++face) publish_face(first, kLamp, face, 8);
  EXPECT_EQ(next_visibility([](const auto& body) { return body.scene_version() == 3; }).of_sources.at(0),
            (std::vector<float>{1, 1, 1}));

  SceneState brighter = scene(4, -2.0F);
  brighter.light.sun_depth_version = 3;
  brighter.light.sources[0].intensity = glm::vec3(9);
  publish_scene(brighter);
  const Relit same = next_visibility();
  EXPECT_EQ(same.scene_version, 4U);
  EXPECT_EQ(same.of_gaussian, (std::vector<float>{1, 0, 1}));
  EXPECT_EQ(same.of_sources.at(0), (std::vector<float>{1, 1, 1}));

  SceneState hidden = brighter;
  hidden.version = 5;
  hidden.light.sources[0].depth_version = 71;
  for (std::uint8_t face = 0; face < 6; ++face) publish_face(hidden, kLamp, face, 0.5F);
  const Relit other = next_visibility([](const auto& body) { return body.scene_version() == 5; });
  EXPECT_EQ(other.of_sources.at(0), (std::vector<float>{0, 0, 0}));
  publish_picture(brighter);
  const Relit earlier = next_visibility([](const auto& body) { return body.scene_version() == 4; });
  EXPECT_EQ(earlier.of_sources.at(0), (std::vector<float>{1, 1, 1})) << "with the maps of its own depth version";
}

/// The sun's maps of another number of cascades are others: those before do not make up for one that is missing.
TEST_F(RelightTest, CascadesThatComeAreAwaited) {
  publish_model(1);
  publish_depth(1, -2.95F);  // at the map's border, where only the last map has all of the filter
  ASSERT_EQ(visibility(1, 1), (std::vector<float>{1, 0, 1}));
  Camera camera = look_at({0, 10, 0}, {0, 0, 0}, kTexels, kTexels, 1.0F);
  camera.role = CameraRole::Light;
  camera.fx = camera.fy = kTexels / 8.0F;
  const std::vector<float> shade(std::size_t{kTexels} * kTexels, 5.0F), lit(shade.size(), 10.0F);
  publish_map(scene(1, -2.95F), 0, 1, 2, camera, shade);
  publish_model(2);
  ASSERT_EQ(visibility(2, 1), (std::vector<float>{1, 0, 1})) << "with the map that it has had, until all are there";
  camera.fx = camera.fy = kTexels / 4.0F;
  publish_map(scene(1, -2.95F), 0, 0, 2, camera, lit);
  EXPECT_EQ(visibility(2, 1), (std::vector<float>{1, 1, 0})) << "the fine one, and outside of it the other";
}

TEST_F(RelightTest, BadMessagesHarmNobody) {
  publish_depth(1, 0, false);  // not the sun's camera
  sources = {lamp(1)};
  const SceneState state = scene(1, 0);
  publish_face(state, 9, 0, 8);      // of no light of the scene
  publish_face(state, kLamp, 6, 8);  // one of six
  Camera camera = look_at({0, 10, 0}, {0, 0, 0}, kTexels, kTexels, 1.0F);
  camera.role = CameraRole::Light;
  const std::vector<float> depth(std::size_t{kTexels} * kTexels, 5.0F);
  publish_map(state, 0, 0, 0, camera, depth);
  publish_map(state, 0, 200, 255, camera, depth);
  sources.clear();
  publish_lie(1, 7);
  publish_lie(2);
  publisher_.publish(Topic<wire::RelightVisibility>{"scene/light_depth", false, kSchema<wire::SceneUpdate>},
                     [&](auto& builder, auto header) {
                       const std::uint32_t sun = 0;
                       return wire::CreateRelightVisibility(builder, header, 1, 1, 1, builder.CreateVector(&sun, 1));
                     });
  publish_model(3);
  publish_depth(4, -2.0F);
  EXPECT_EQ(visibility(3, 4), (std::vector<float>{1, 0, 1}));
}

}  // namespace
}  // namespace splatbus::relight

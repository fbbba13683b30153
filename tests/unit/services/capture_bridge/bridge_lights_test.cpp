// Depth maps of lights: which are asked for, and what of them is handed on.
#include <limits>
#include <set>

#include "bridge_fixture.h"
#include "wire/scene_generated.h"

namespace splatbus::capture_bridge::test {

class BridgeLightsTest : public CaptureBridgeTest {
 protected:
  /// The scene as it is now, in a picture that nobody has asked for.
  void tell_scene() {
    Camera camera = look_at({0, 2, 2}, {0, 0, 0}, 16, 16, 1);
    camera.role = CameraRole::Reference;
    camera.id = 77;
    engine_.submit(camera, wire::EngineBuffer::Color, 0);
  }
  /// Of scene/light_depth, by light and map, the newest of each.
  [[nodiscard]] std::map<std::pair<std::uint32_t, std::uint32_t>, const wire::SceneLightDepth*> depths() {
    std::map<std::pair<std::uint32_t, std::uint32_t>, const wire::SceneLightDepth*> found;
    for (const bus::Message& message : received_["scene/light_depth"]) {
      const auto& depth = message.root<wire::SceneLightDepth>();
      found[{depth.light_id(), depth.light_map()}] = &depth;
    }
    return found;
  }
};

TEST_F(BridgeLightsTest, MapsOfEveryLightComeUnderItsNameAndTheSceneOfTheirFrame) {
  settle();
  engine_.light.sources = {
      {.id = 4, .position = {0, 2, 0}, .intensity = glm::vec3(1), .depth_version = 0},
      {.id = 9, .kind = LightKind::Spot, .position = {0, 3, 0}, .direction = {0, -1, 0}, .depth_version = 55}};
  tell_scene();
  ASSERT_TRUE(until([&] { return depths().size() == 8; }));
  for (const auto& [key, depth] : depths()) {
    const SceneState scene = from_wire(*depth->scene());
    EXPECT_EQ(depth->light_maps(), key.first == 4 ? 6 : 1);
    if (key.first == 0) continue;
    EXPECT_EQ(depth->camera()->world_from_camera().translation().y(), key.first == 4 ? 2 : 3);
    ASSERT_EQ(scene.light.sources.size(), 2U);
    EXPECT_EQ(scene.light.sources[0].depth_version, scene.version) << "an engine that does not say: with every scene";
    EXPECT_EQ(scene.light.sources[1].depth_version, 55 + engine_.epoch());
  }
  std::set<std::uint64_t> slabs;
  std::set<std::string> keys;
  for (const bus::Message& message : received_["scene/light_depth"]) {
    slabs.insert(message.header().tensors()->Get(0)->span()->slab());
    keys.insert(message.header().latch_key()->str());
  }
  EXPECT_EQ(keys.size(), 8U) << "each is latched";
  EXPECT_EQ(slabs.size(), 8U) << "where those that change do not write";
  engine_.light.sources.clear();
  tell_scene();
  EXPECT_TRUE(until([&] { return engine_.requested(CameraRole::Light) == 1; })) << "for lights that are no more none";
}

/// The sun's map of a large scene brings cascades about the rig, of which the finest goes with a viewer that walks.
TEST_F(BridgeLightsTest, ALargeSceneGetsCascadesThatFollowTheViewer) {
  engine_.scene_m = 283;
  settle();
  ASSERT_TRUE(until([&] {
    return depths().contains({0, 0}) && depths().contains({0, 1}) && depths().contains({0, 2});
  }));
  const auto extent_m = [](const wire::SceneLightDepth& depth) {
    return static_cast<float>(depth.camera()->width()) / depth.camera()->fx();
  };
  EXPECT_EQ(depths().at({0, 2})->light_maps(), 3);
  EXPECT_NEAR(extent_m(*depths().at({0, 2})), 283, 0.1F);
  ASSERT_TRUE(until([&] { return extent_m(*depths().at({0, 0})) < 41 && extent_m(*depths().at({0, 1})) < 161; }));
  const auto place = [&](std::uint32_t map) {
    for (const FakeEngine::Request& request : engine_.requests()) {
      if (request.camera.role != CameraRole::Light || request.light_map != map) continue;
      return request.camera.world_from_camera.translation;
    }
    return glm::vec3(0);
  };
  const glm::vec3 before = place(1);
  look_from(look_at({10, 1.6F, 0}, {11, 1.5F, 0}, 64, 64, 1));
  ASSERT_TRUE(until([&] { return place(0).x > 8; }));
  EXPECT_EQ(place(1), before);
}

TEST_F(BridgeLightsTest, DegenerateLightCamerasAreRefusedAndTheRestGoesOn) {
  settle();
  const FakeEngine::Request sun = [&] {
    for (const FakeEngine::Request& request : engine_.requests()) {
      if (request.camera.role == CameraRole::Light) return request;
    }
    return FakeEngine::Request{};
  }();
  const float nan = std::numeric_limits<float>::quiet_NaN();
  std::uint64_t refused = bridge_->counters().refused;
  for (const std::function<void(Camera&)>& spoil : std::vector<std::function<void(Camera&)>>{
           [](Camera& camera) { camera.fx = camera.fy = 1e9F; },
           [&](Camera& camera) { camera.world_from_camera.translation.x = nan; },
           [](Camera& camera) { camera.far_m = camera.near_m; },
           [](Camera& camera) { camera.world_from_camera.rotation = glm::quat(1, 0, 0, 0); }}) {
    engine_.turn_light_camera = spoil;
    engine_.submit_light(sun);
    ++refused;
    ASSERT_TRUE(until([&] { return bridge_->counters().refused == refused; }));
  }
  engine_.turn_light_camera = nullptr;
  engine_.submit(sun.camera, sun.buffers, sun.id, 8);  // of no light
  ASSERT_TRUE(until([&] { return bridge_->counters().refused == refused + 1; }));
  engine_.submit(sun.camera, sun.buffers, sun.id, 0, 3);  // a cascade that was not asked for
  const std::size_t maps = received_["scene/light_depth"].size();
  engine_.submit_light(sun);
  ASSERT_TRUE(until([&] { return received_["scene/light_depth"].size() > maps; }));
  EXPECT_EQ(depths().size(), 1U);
  EXPECT_EQ(bridge_->counters().refused, refused + 1);
}

/// A picture and a map of one frame are of one version; a change of the light alone makes another one for both.
TEST_F(BridgeLightsTest, MapsAndPicturesOfAFrameShareItsVersion) {
  settle();
  engine_.light.sources = {{.id = 4, .position = {0, 2, 0}, .depth_version = 3}};
  tell_scene();
  ASSERT_TRUE(until([&] { return depths().contains({4, 5}); }));
  const auto picture = [&] { return references(CameraRole::Reference).back()->scene(); };
  const std::uint64_t version = picture()->version();
  EXPECT_EQ(depths().at({4, 5})->scene()->version(), version);
  for (int change = 0; change < 3; ++change) {
    LightSource& lamp = engine_.light.sources[0];
    if (change == 0) lamp.intensity.x += 1;
    if (change == 1) lamp.depth_version += 1;
    if (change == 2) engine_.light.sun_depth_version += 1;
    const std::uint64_t before = picture()->version();
    tell_scene();
    ASSERT_TRUE(until([&] { return picture()->version() > before; })) << change;
    const Light light = from_wire(*picture()->light());
    ASSERT_EQ(light.sources.size(), 1U);
    EXPECT_EQ(light.sources[0].intensity, lamp.intensity) << change;
    EXPECT_EQ(light.sources[0].depth_version, lamp.depth_version + engine_.epoch()) << change;
    EXPECT_EQ(light.sun_depth_version, change == 2 ? 1 + engine_.epoch() : picture()->version()) << change;
  }
}

/// It may show something else under the same light, and counts its depth versions from the beginning.
TEST_F(BridgeLightsTest, AnEngineThatIsStartedAgainHasOtherVersions) {
  engine_.light.sun_depth_version = 7;
  settle();
  const auto light_of_newest = [&] { return received_["scene/state"].back().root<wire::SceneUpdate>().scene(); };
  const std::uint64_t version = light_of_newest()->version();
  const std::uint64_t depth_version = from_wire(*light_of_newest()->light()).sun_depth_version;
  const Light light = engine_.light;
  running_engine_.reset();  // its name is free when its connection has ended
  FakeEngine again(connect("engine"));
  again.light = light;
  Camera camera = look_at({0, 2, 2}, {0, 0, 0}, 16, 16, 1);
  camera.role = CameraRole::Reference;
  ASSERT_TRUE(until([&] {
    again.submit(camera, wire::EngineBuffer::Color, 0);
    return light_of_newest()->version() > version;
  }));
  EXPECT_NE(from_wire(*light_of_newest()->light()).sun_depth_version, depth_version);
}

}  // namespace splatbus::capture_bridge::test

// Several engines that show one world.
#include <algorithm>
#include <limits>
#include <set>

#include "bridge_fixture.h"
#include "liveness.h"
#include "wire/scene_generated.h"

namespace splatbus::capture_bridge::test {

class BridgeEnginesTest : public CaptureBridgeTest {
 protected:
  BridgeEnginesTest() : other_(connect("other")) { set("reference_cameras", "6"); }

  void hear(const std::vector<Node>& nodes) {
    with_liveness(nodes, 0, [&](const wire::Liveness& liveness) { bridge_->take(liveness); });
  }
  void start_both() {
    start();
    hear({{"engine", 1}, {"other", 2}});
  }
  /// As until(), with both engines.
  bool until_both(const std::function<bool()>& condition, std::chrono::milliseconds timeout = bus_test::patience) {
    return until(
        [&] {
          other_.serve();
          return condition();
        },
        timeout);
  }
  /// Of reference cameras, the newest version of each.
  std::map<std::uint32_t, std::uint64_t> versions() {
    std::map<std::uint32_t, std::uint64_t> newest;
    for (const wire::CaptureReference* reference : references(CameraRole::Reference)) {
      if (!reference->retire()) newest[reference->camera()->id()] = reference->scene()->version();
    }
    return newest;
  }
  static std::size_t views(const FakeEngine& engine) {
    return engine.requested(CameraRole::Reference) + engine.requested(CameraRole::Input);
  }

  /// Until it rests: no picture of it comes any more, but its ticks go on, and equal the other's.
  void minimise(FakeEngine& engine) {
    start_both();
    ASSERT_TRUE(until_both([&] { return versions().size() == 6; }));
    engine.lose = [](const Camera&) { return true; };
    float tick = 0;
    auto next = std::chrono::steady_clock::now();
    EXPECT_TRUE(until_both(
        [&] {
          if (std::chrono::steady_clock::now() >= next) {
            next += 100ms;
            engine_.objects[7] = other_.objects[7] = Rigid{.translation = {tick += 0.1F, 0, 0}};
            engine_.submit_scene();
            other_.submit_scene();
          }
          return bridge_->engines().resting() == 1;
        },
        20s));
  }

  FakeEngine other_;
};

TEST_F(BridgeEnginesTest, EachRendersItsPartAndTogetherTheyMakeOneModel) {
  start_both();
  ASSERT_TRUE(until_both([&] { return versions().size() == 6 && !received_["capture/input"].empty(); }));
  EXPECT_EQ(views(engine_) + views(other_), 10U);
  EXPECT_GE(views(engine_), 4U);
  EXPECT_GE(views(other_), 4U);
  EXPECT_EQ(other_.requested(CameraRole::Light), 0U);
  EXPECT_GT(engine_.requested(CameraRole::Light), 0U);
  // What is shown is one still scene.
  std::set<std::uint64_t> numbers;
  for (const auto& [camera, version] : versions()) numbers.insert(version);
  EXPECT_EQ(numbers.size(), 1U);
  EXPECT_GE(bridge_->counters().frames_followed, 4U);
  EXPECT_EQ(bridge_->counters().frames_unmatched, 0U);
}

TEST_F(BridgeEnginesTest, APictureHasTheVersionThatItShowsThoughTheOtherEngineIsAheadOrBehind) {
  start_both();
  ASSERT_TRUE(until_both([&] { return versions().size() == 6; }));
  const std::uint64_t at_rest = versions().begin()->second;
  Camera camera = look_at({0, 2, 2}, {0, 0, 0}, 16, 16, 1);
  camera.role = CameraRole::Reference;
  const auto submit = [&](FakeEngine& engine, std::uint32_t id, float x_m) {
    camera.id = id;
    engine.objects[7] = Rigid{.translation = {x_m, 0, 0}};
    engine.submit(camera, wire::EngineBuffer::Color, 0);
  };
  // Ahead: its picture waits for the version.
  submit(other_, 50, 1);
  EXPECT_FALSE(until_both([&] { return versions().contains(50); }, 100ms));
  submit(engine_, 60, 1);
  ASSERT_TRUE(until_both([&] { return versions().contains(50) && versions().contains(60); }));
  EXPECT_EQ(versions()[50], versions()[60]);
  EXPECT_GT(versions()[50], at_rest);
  // Behind: it is of the version before.
  submit(engine_, 61, 2);
  ASSERT_TRUE(until_both([&] { return versions().contains(61); }));
  submit(other_, 51, 1);
  ASSERT_TRUE(until_both([&] { return versions().contains(51); }));
  EXPECT_EQ(versions()[51], versions()[60]);
  EXPECT_GT(versions()[61], versions()[60]);
  for (const bus::Message& message : received_["capture/reference"]) {
    const auto& reference = message.root<wire::CaptureReference>();
    if (reference.camera()->id() != 51) continue;
    const ObjectTransforms objects = from_wire(reference.scene()->objects());
    EXPECT_EQ(objects.at(7).rigid.translation.x, 1);
  }
  // What the bridge says next of the scene is the newest's.
  submit(engine_, 62, 2);
  ASSERT_TRUE(until_both([&] { return versions().contains(62); }));
  EXPECT_EQ(versions()[62], versions()[61]);
}

TEST_F(BridgeEnginesTest, WhatOnlyTheOtherEngineShowsTrainsNothingAndIsAskedForAgain) {
  start();
  other_.objects[7] = Rigid{.translation = {9, 0, 0}};
  hear({{"engine", 1}, {"other", 2}});
  ASSERT_TRUE(until_both([&] { return bridge_->counters().frames_unmatched >= 4; }));
  for (const bus::Message& message : received_["scene/state"]) {
    EXPECT_FALSE(from_wire(message.root<wire::SceneUpdate>().scene()->objects()).contains(7));
  }
  const std::size_t before = versions().size();
  EXPECT_LT(before, 6U);
  other_.objects.clear();
  ASSERT_TRUE(until_both([&] { return versions().size() == 6; }));
}

TEST_F(BridgeEnginesTest, DepthMapsAreTheLeadsAndWhoIsAskedByNobodyYetRendersNothing) {
  start();
  ASSERT_TRUE(until([&] { return views(engine_) == 10; }));  // all of them, for whoever there is
  hear({{"engine", 1}, {"other", 2}});
  ASSERT_TRUE(until_both(
      [&] { return views(engine_) < 10 && versions().size() == 6 && !received_["scene/light_depth"].empty(); }));
  const auto light = std::ranges::find(engine_.requests(), CameraRole::Light,
                                       [](const FakeEngine::Request& request) { return request.camera.role; });
  ASSERT_NE(light, engine_.requests().end());
  ASSERT_TRUE(until_both([&] { return bridge_->counters().light_depths == engine_.light_maps_drawn; }));
  other_.submit_light(*light);
  Camera camera = look_at({0, 2, 2}, {0, 0, 0}, 16, 16, 1);
  camera.role = CameraRole::Reference;
  camera.id = 77;  // comes after it
  other_.submit(camera, wire::EngineBuffer::Color, 0);
  ASSERT_TRUE(until_both([&] { return versions().contains(77); }));
  EXPECT_LE(bridge_->counters().light_depths, engine_.light_maps_drawn);
  FakeEngine third(connect("third"));
  EXPECT_FALSE(bus_test::eventually(
      [&] {
        third.serve();
        return !third.submitted.empty();
      },
      200ms));
  hear({{"engine", 1}, {"other", 2}, {"third", 3}});
  ASSERT_TRUE(until_both([&] {
    third.serve();
    return views(third) >= 3;
  }));
}

TEST_F(BridgeEnginesTest, AnEngineThatGoesLeavesItsCamerasAndItsPlaceToTheOther) {
  start_both();
  ASSERT_TRUE(until_both([&] { return versions().size() == 6; }));
  const std::uint64_t before = versions().begin()->second;
  running_engine_.reset();
  hear({{.name = "engine", .epoch = 1, .alive = false}, {"other", 2}});
  received_.clear();
  ASSERT_TRUE(until_both([&] { return views(other_) == 10 && versions().size() == 6; }));
  // The engine that leads now says what the scene is.
  EXPECT_GT(other_.requested(CameraRole::Light), 0U);
  for (const auto& [camera, version] : versions()) EXPECT_GT(version, before) << camera;
}

TEST_F(BridgeEnginesTest, AFollowerThatSaysWhatTheSceneIsAndBringsNoPicturesLosesItsCameras) {
  minimise(other_);
  EXPECT_TRUE(until_both([&] { return views(engine_) == 10; }));
}

TEST_F(BridgeEnginesTest, ALeadThatSaysWhatTheSceneIsAndBringsNoPicturesLosesItsPlace) {
  minimise(engine_);
  EXPECT_TRUE(until_both([&] { return views(other_) == 10; }));
}

TEST_F(BridgeEnginesTest, FramesOfTheOtherThatMakeNoSenseAreRefusedAndTooManyPushTheOldestOut) {
  start_both();
  ASSERT_TRUE(until_both([&] { return versions().size() == 6; }));
  const std::uint64_t refused = bridge_->counters().refused;
  Camera camera = look_at({0, 2, 2}, {0, 0, 0}, 8, 8, 1);
  camera.role = CameraRole::Reference;
  camera.id = 50;
  const Light light = other_.light;
  other_.light.sun_direction = {0, 0, 0};
  other_.submit_scene();
  other_.light = light;
  other_.objects[7] = Rigid{.translation = {9, 0, 0}};  // which nobody else shows: it waits
  camera.fx = -1;
  camera.world_from_camera.translation.x = std::numeric_limits<float>::quiet_NaN();
  other_.submit(camera, wire::EngineBuffer::Color, 0);
  ASSERT_TRUE(until_both([&] { return bridge_->counters().refused == refused + 2; }));
  EXPECT_EQ(bridge_->counters().frames_unmatched, 0U);
  camera = look_at({0, 2, 2}, {0, 0, 0}, 8, 8, 1);
  camera.role = CameraRole::Reference;
  for (camera.id = 50; camera.id < 90; ++camera.id) other_.submit(camera, wire::EngineBuffer::Color, 0);
  const auto begin = std::chrono::steady_clock::now();
  ASSERT_TRUE(until_both([&] { return bridge_->counters().frames_unmatched >= 8; }));
  EXPECT_LT(std::chrono::steady_clock::now() - begin, 400ms);  // before they have waited for long enough
  engine_.objects = other_.objects;
  engine_.submit_scene();
  ASSERT_TRUE(until_both([&] { return versions().contains(89); }));
  EXPECT_EQ(bridge_->counters().frames_unmatched, 8U);
  EXPECT_FALSE(versions().contains(57));
  EXPECT_TRUE(versions().contains(58));
}

}  // namespace splatbus::capture_bridge::test

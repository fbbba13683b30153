#include "capture-bridge/capture_bridge.h"

#include <gtest/gtest.h>

#include <limits>
#include <optional>

#include "../../bus/bus_fixture.h"
#include "capture-bridge/parameters.h"
#include "fake_engine.h"
#include "wire/capture_generated.h"
#include "wire/model_generated.h"
#include "wire/scene_generated.h"
#include "wire/viewer_generated.h"

namespace splatbus::capture_bridge {
namespace {

using namespace std::chrono_literals;

/// A bridge between an engine and readers made by hand, all in this thread but the bridge's sampling.
class CaptureBridgeTest : public bus_test::BusTest {
 protected:
  CaptureBridgeTest()
      : parameters_(parameter_specs()),
        peer_(connect("peer")),
        reader_(peer_, {"capture/*", "scene/*"}),
        engine_(connect("engine")),
        pose_(peer_, "viewer/pose"),
        probe_(peer_, "viewer/probe") {
    set("input_cameras", "4");
    set("input_size", "32");
    set("reference_cameras", "2");
    set("reference_size", "16");
    set("reference_rate_hz", "0");
    set("light_depth_size", "16");
    set("input_deadline_s", "0.2");
  }

  void set(const std::string& name, const std::string& value) { ASSERT_EQ(parameters_.set(name, value, true), ""); }

  void start() { bridge_ = std::make_unique<CaptureBridge>(connect("capture-bridge"), parameters_); }

  /// Runs bridge and engine and reads what comes out, until the condition holds.
  bool until(const std::function<bool()>& condition, std::chrono::milliseconds timeout = bus_test::patience) {
    return bus_test::eventually(
        [&] {
          bridge_->step(1ms);
          engine_.serve();
          while (auto message = reader_.receive(0ms)) received_[message->topic()].push_back(*message);
          return condition();
        },
        timeout);
  }

  void settle() {
    start();
    ASSERT_TRUE(until([&] {
      return !received_["capture/input"].empty() && references(CameraRole::Reference).size() == 2 &&
             references(CameraRole::Input).size() == 4 && !received_["scene/light_depth"].empty();
    }));
  }

  std::vector<const wire::CaptureReference*> references(CameraRole role) {
    std::vector<const wire::CaptureReference*> found;
    for (const bus::Message& message : received_["capture/reference"]) {
      const auto& reference = message.root<wire::CaptureReference>("CaptureReference/1");
      if (reference.camera()->role() == static_cast<wire::CameraRole>(role)) found.push_back(&reference);
    }
    return found;
  }

  const wire::CaptureInput& last_input() {
    return received_["capture/input"].back().root<wire::CaptureInput>("CaptureInput/1");
  }

  void look_from(const Camera& camera) {
    pose_.publish({.schema = "ViewerPose/1"}, [&](auto& builder, auto header) {
      const wire::Camera out = to_wire(camera);
      return wire::CreateViewerPose(builder, header, builder.CreateString("viewer-1"), &out);
    });
  }

  void ask_probe(std::uint64_t id, const Camera& camera) {
    probe_.publish({.schema = "ViewerProbe/1"}, [&](auto& builder, auto header) {
      const wire::Camera out = to_wire(camera);
      return wire::CreateViewerProbe(builder, header, id, &out);
    });
  }

  bus::Parameters parameters_;
  std::shared_ptr<bus::Context> peer_;
  bus::Subscriber reader_;
  test::FakeEngine engine_;
  bus::Publisher pose_, probe_;
  std::map<std::string, std::vector<bus::Message>> received_;
  std::unique_ptr<CaptureBridge> bridge_;
};

TEST_F(CaptureBridgeTest, TurnsAnEnginesFramesIntoSamplesAndViews) {
  engine_.objects[test::AnalyticScene::kBall] = {.translation = {1, 2, 3}};
  settle();
  const bus::Message& message = received_["capture/input"].front();
  const auto& input = message.root<wire::CaptureInput>("CaptureInput/1");
  ASSERT_EQ(input.cameras()->size(), 4U);
  EXPECT_EQ(input.objects()->size(), 1U);
  EXPECT_GT(input.rig_generation(), 0U);
  EXPECT_EQ(message.header().capture_ns(), 1234);
  const auto position = message.tensor("position", bus::ElementType::F32, {0, 3});
  ASSERT_TRUE(position);
  const std::uint32_t n = position->dim(0);
  EXPECT_GT(n, 200U);
  for (const char* name : {"normal", "albedo", "color"})
    EXPECT_TRUE(message.tensor(name, bus::ElementType::F32, {n, 3}));
  for (const char* name : {"footprint", "spacing", "cosine"})
    EXPECT_TRUE(message.tensor(name, bus::ElementType::F32, {n}));
  for (const char* name : {"object_id", "camera"}) EXPECT_TRUE(message.tensor(name, bus::ElementType::U32, {n}));
  EXPECT_TRUE(message.tensor("depth", bus::ElementType::F32, {4, 32, 32}));

  const bus::Message& view = received_["capture/reference"].front();
  const auto& reference = view.root<wire::CaptureReference>("CaptureReference/1");
  const std::uint32_t size = reference.camera()->width();
  EXPECT_TRUE(view.tensor("color", bus::ElementType::U8, {size, size, 4}));
  EXPECT_TRUE(view.tensor("albedo", bus::ElementType::U8, {size, size, 4}));
  EXPECT_EQ(view.header().tensors()->Get(0)->span()->slab(), view.header().tensors()->Get(1)->span()->slab());
  EXPECT_FALSE(received_["scene/light"].empty());
  EXPECT_FALSE(received_["scene/objects"].empty());
}

TEST_F(CaptureBridgeTest, AStillSceneIsCapturedOnce) {
  settle();
  const auto submitted = engine_.submitted;
  for (int i = 0; i < 50; ++i) {
    look_from(look_at({0, 1, 3.3F}, {0, 0.25F, 0}, 64, 64, 1));
    ASSERT_TRUE(until([] { return true; }));
  }
  EXPECT_EQ(engine_.submitted, submitted);
  EXPECT_EQ(received_["scene/light"].size(), 1U);
  EXPECT_EQ(received_["scene/objects"].size(), 1U);
}

TEST_F(CaptureBridgeTest, AViewerThatMovesTakesTheInputRigAlong) {
  settle();
  const std::uint64_t generation = last_input().rig_generation();
  look_from(look_at({2, 1.6F, 3.4F}, {2, 0.25F, 0}, 64, 64, 1));
  ASSERT_TRUE(until([&] { return last_input().rig_generation() > generation; }));
  glm::vec3 middle(0);
  for (const wire::Camera* camera : *last_input().cameras()) middle += from_wire(*camera).world_from_camera.translation;
  EXPECT_GT((middle / 4.0F).x, 1.0F);
}

TEST_F(CaptureBridgeTest, ALostFrameBlocksNoRoundAndIsAskedForAgain) {
  bool losing = true;
  engine_.lose = [&](const Camera& camera) { return losing && camera.role == CameraRole::Input && camera.id == 2; };
  start();
  ASSERT_TRUE(until([&] { return !received_["capture/input"].empty(); }));
  EXPECT_EQ(last_input().cameras()->size(), 3U);
  losing = false;
  ASSERT_TRUE(until([&] { return last_input().cameras()->size() == 4; }));
}

TEST_F(CaptureBridgeTest, ProbesAreEachAnsweredOnce) {
  settle();
  const Camera camera = look_at({0, 2, 2}, {0, 0, 0}, 24, 20, 1);
  for (std::uint64_t id = 10; id < 15; ++id) ask_probe(id, camera);
  ask_probe(12, camera);
  ASSERT_TRUE(until([&] { return received_["capture/probe"].size() >= 5 && bridge_->cameras() == 7; }));
  std::multiset<std::uint64_t> answered;
  for (const bus::Message& message : received_["capture/probe"]) {
    answered.insert(message.root<wire::CaptureProbe>("CaptureProbe/1").probe_id());
    EXPECT_TRUE(message.tensor("color", bus::ElementType::U8, {20, 24, 4}));
  }
  for (std::uint64_t id = 10; id < 15; ++id) EXPECT_GE(answered.count(id), 1U) << id;
  EXPECT_LE(answered.size(), 6U) << "12 may be asked again once it was answered";
}

TEST_F(CaptureBridgeTest, AProbeThatTheEngineLosesIsAskedForAgainAndThenDropped) {
  set("probe_timeout_s", "0.3");
  settle();
  engine_.lose = [](const Camera& camera) { return camera.role == CameraRole::Probe; };
  ask_probe(1, look_at({0, 2, 2}, {0, 0, 0}, 24, 20, 1));
  ASSERT_TRUE(until([&] { return bridge_->counters().probes_dropped == 1; }));
  EXPECT_EQ(bridge_->cameras(), 7U);
  EXPECT_TRUE(received_["capture/probe"].empty());
}

TEST_F(CaptureBridgeTest, CamerasThatLeaveAreRetired) {
  settle();
  set("reference_cameras", "1");
  ASSERT_TRUE(until([&] { return references(CameraRole::Reference).back()->retire(); }));
  EXPECT_EQ(references(CameraRole::Reference).back()->camera()->id(), 1U);
}

TEST_F(CaptureBridgeTest, WithoutInputViewsOnlyReferencesAreForwarded) {
  set("input_views", "false");
  start();
  ASSERT_TRUE(
      until([&] { return !received_["capture/input"].empty() && references(CameraRole::Reference).size() == 2; }));
  EXPECT_TRUE(references(CameraRole::Input).empty());
}

TEST_F(CaptureBridgeTest, LatchedSceneStateReachesALateReaderWithItsPixels) {
  settle();
  // What the engine renders afterwards must not take the latched depth map away.
  bus::Subscriber late(connect("late"), {"scene/*"});
  std::set<std::string> topics;
  ASSERT_TRUE(until([&] {
    while (auto message = late.receive(0ms)) {
      topics.insert(message->topic());
      if (message->topic() != "scene/light_depth") continue;
      const auto depth = message->tensor("light_depth", bus::ElementType::F32, {16, 16});
      EXPECT_TRUE(depth && depth->as<float>()[0] == 7.0F);
      EXPECT_NE(message->header().tensors()->Get(0)->span()->slab(),
                received_["capture/reference"].front().header().tensors()->Get(0)->span()->slab());
    }
    return topics.size() == 3;
  }));
}

TEST_F(CaptureBridgeTest, ChangesOfLightAndObjectsArePublished) {
  settle();
  const Camera camera = look_at({0, 2, 2}, {0, 0, 0}, 16, 16, 1);
  engine_.objects[5] = {.translation = {1, 1, 1}};
  engine_.submit(camera, wire::EngineBuffer::Color, 0);
  ASSERT_TRUE(until([&] { return received_["scene/objects"].size() == 2; }));
  EXPECT_EQ(received_["scene/light"].size(), 1U);
  engine_.light.generation = 2;
  engine_.light.sun_irradiance = {2, 2, 2};
  engine_.submit(camera, wire::EngineBuffer::Color, 0);
  ASSERT_TRUE(until([&] { return received_["scene/light"].size() == 2; }));
  // A frame from before, late: the newest state stands.
  engine_.frame = 0;
  engine_.objects.clear();
  engine_.submit(camera, wire::EngineBuffer::Color, 0);
  const auto frames = bridge_->counters().frames;
  ASSERT_TRUE(until([&] { return bridge_->counters().frames > frames; }));
  EXPECT_EQ(received_["scene/objects"].size(), 2U);
}

TEST_F(CaptureBridgeTest, NaNPositionsAreDroppedAndTheRestGoesOn) {
  engine_.spoil = [](std::vector<glm::vec4>& positions) {
    for (std::size_t i = 0; i < positions.size(); i += 2) positions[i].y = std::numeric_limits<float>::quiet_NaN();
  };
  settle();
  const auto view = received_["capture/input"].front().tensor("position", bus::ElementType::F32, {0, 3});
  ASSERT_TRUE(view);
  EXPECT_GT(view->dim(0), 100U);
  for (const float value : view->as<float>()) ASSERT_TRUE(std::isfinite(value));
  EXPECT_TRUE(until([&] { return bridge_->input_statistics().dropped > 0; }));
}

TEST_F(CaptureBridgeTest, BrokenFramesAreRefusedAndNothingElseDisturbed) {
  start();
  // Wrong schema, a camera with NaN, pictures smaller than the camera says, a role that does not exist, no pictures.
  ASSERT_TRUE(until([&] { return engine_.requested(CameraRole::Input) == 4; }));
  bus::Publisher garbage(peer_, "engine/frame");
  const auto publish = [&](const char* schema, wire::Camera camera, std::vector<bus::OutgoingTensor> tensors) {
    garbage.publish({.schema = schema, .tensors = std::move(tensors)}, [&](auto& builder, auto header) {
      const auto light = to_wire(builder, Light{});
      return wire::CreateEngineFrame(builder, header, 1, 0, 1, &camera, 0, light);
    });
  };
  Camera nan = look_at({0, 2, 2}, {0, 0, 0}, 16, 16, 1);
  nan.fx = std::numeric_limits<float>::quiet_NaN();
  Camera role = look_at({0, 2, 2}, {0, 0, 0}, 16, 16, 1);
  role.role = static_cast<CameraRole>(9);
  Camera input = look_at({0, 2, 2}, {0, 0, 0}, 16, 16, 1);
  input.role = CameraRole::Input;
  const std::vector<std::uint8_t> few(4 * 4 * 4);
  const std::vector<bus::OutgoingTensor> small{
      {.name = "world_position", .shape = {4, 4, 4}, .type = bus::ElementType::U8, .inline_data = few.data()}};
  ASSERT_TRUE(until([&] {
    publish("EngineFrames/7", to_wire(input), {});
    publish("EngineFrame/1", to_wire(nan), {});
    publish("EngineFrame/1", to_wire(role), {});
    publish("EngineFrame/1", to_wire(input), small);
    return bridge_->counters().frames_refused >= 20;
  }));
  const auto before = received_["capture/input"].size();
  set("input_radius_m", "3.0");
  EXPECT_TRUE(until([&] { return received_["capture/input"].size() > before && last_input().cameras()->size() == 4; }));
}

TEST_F(CaptureBridgeTest, AnExpanderThatMissedTheRoundGetsItAgain) {
  settle();
  const auto rounds = received_["capture/input"].size();
  const auto submitted = engine_.submitted;
  bus::Publisher state(peer_, "grid/state");
  ASSERT_TRUE(until([&] {
    state.publish({.schema = "GridState/1"},
                  [](auto& builder, auto header) { return wire::CreateGridState(builder, header); });
    return received_["capture/input"].size() > rounds;
  }));
  EXPECT_EQ(engine_.submitted, submitted) << "from the frames that the bridge has";
}

TEST_F(CaptureBridgeTest, ATrainerThatMissedTheViewsGetsThemAgain) {
  settle();
  bus::Publisher stats(peer_, "trainer/stats");
  const auto inputs = references(CameraRole::Input).size();
  ASSERT_TRUE(until([&] {
    stats.publish({.schema = "TrainerStats/1"},
                  [](auto& builder, auto header) { return wire::CreateTrainerStats(builder, header); });
    return references(CameraRole::Input).size() >= inputs + 4 && references(CameraRole::Reference).size() >= 4;
  }));
}

}  // namespace
}  // namespace splatbus::capture_bridge

// What the bridge does about frames that are lost or broken, and about peers that have missed something.
#include <cmath>
#include <functional>
#include <limits>

#include "bridge_fixture.h"
#include "wire/model_generated.h"

namespace splatbus::capture_bridge::test {
namespace {

TEST_F(CaptureBridgeTest, ALostFrameBlocksNoRoundAndIsAskedForAgain) {
  bool losing = true;
  engine_.lose = [&](const Camera& camera) { return losing && camera.role == CameraRole::Input && camera.id == 2; };
  start();
  ASSERT_TRUE(until([&] { return !received_["capture/input"].empty(); }));
  EXPECT_EQ(last_input().cameras()->size(), 3U);
  losing = false;
  ASSERT_TRUE(until([&] { return last_input().cameras()->size() == 4; }));
}

TEST_F(CaptureBridgeTest, OldPicturesWaitForTheRoundUnderWayButNotForEver) {
  set("input_refresh_hz", "1000");
  set("reference_refresh_hz", "1000");
  set("input_deadline_s", "60");
  engine_.lose = [](const Camera& camera) { return camera.role == CameraRole::Input && camera.id == 2; };
  start();
  int turns = 0;
  Camera unasked = look_at({0, 2, 2}, {0, 0, 0}, 8, 8, 1);
  unasked.role = CameraRole::Probe;
  unasked.id = 1'000'000;
  const auto until_turning = [&](const std::function<bool()>& condition) {
    return until([&] {
      const float angle = 0.01F * static_cast<float>(++turns);
      engine_.light.sun_direction = {std::sin(angle), std::cos(angle), 0};
      engine_.submit(unasked, wire::EngineBuffer::Color, 0);  // tells of the light, whatever is asked for
      return condition();
    });
  };
  ASSERT_TRUE(until_turning([&] { return references(CameraRole::Input).size() == 3; }));
  const std::size_t seen = references(CameraRole::Reference).size();
  ASSERT_TRUE(until_turning([&] { return references(CameraRole::Reference).size() >= seen + 20; }));
  EXPECT_EQ(references(CameraRole::Input).size(), 3U) << "the light has changed, and one of the place is missing";
  set("input_deadline_s", "0.05");
  EXPECT_TRUE(until_turning([&] { return references(CameraRole::Input).size() > 8; }));
}

TEST_F(CaptureBridgeTest, ALightMapThatTheEngineLosesIsAskedForAgain) {
  bool losing = true;
  engine_.lose = [&](const Camera& camera) { return losing && camera.role == CameraRole::Light; };
  start();
  ASSERT_TRUE(until([&] { return !received_["capture/input"].empty(); }));
  EXPECT_TRUE(received_["scene/light_depth"].empty());
  losing = false;
  EXPECT_TRUE(until([&] { return !received_["scene/light_depth"].empty(); }));
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
  bus::Publisher garbage(peer_);
  const auto publish = [&](std::string_view schema, wire::Camera camera, std::vector<bus::OutgoingTensor> tensors) {
    garbage.publish(Topic<wire::EngineFrame>{"engine/frame", false, schema}, {.tensors = std::move(tensors)},
                    [&](auto& builder, auto header) {
                      const auto scene = to_wire(builder, SceneState{}, 1);
                      return wire::CreateEngineFrame(builder, header, 1, &camera, scene);
                    });
  };
  Camera nan = look_at({0, 2, 2}, {0, 0, 0}, 16, 16, 1);
  nan.fx = std::numeric_limits<float>::quiet_NaN();
  Camera role = look_at({0, 2, 2}, {0, 0, 0}, 16, 16, 1);
  role.role = static_cast<CameraRole>(9);
  Camera input = look_at({0, 2, 2}, {0, 0, 0}, 16, 16, 1);
  input.role = CameraRole::Input;
  const std::vector<std::uint8_t> few(std::size_t{4} * 4 * 4);
  const std::vector<bus::OutgoingTensor> small{
      {.name = "world_position", .shape = {4, 4, 4}, .type = bus::ElementType::U8, .inline_data = few.data()}};
  ASSERT_TRUE(until([&] {
    publish("EngineFrames/7", to_wire(input), {});
    publish(kSchema<wire::EngineFrame>, to_wire(nan), {});
    publish(kSchema<wire::EngineFrame>, to_wire(role), {});
    publish(kSchema<wire::EngineFrame>, to_wire(input), small);
    return bridge_->counters().refused >= 20;
  }));
  const auto before = received_["capture/input"].size();
  set("input_radius_m", "3.0");
  EXPECT_TRUE(until([&] { return received_["capture/input"].size() > before && last_input().cameras()->size() == 4; }));
}

TEST_F(CaptureBridgeTest, AnExpanderThatMissedTheRoundGetsItAgain) {
  settle();
  const auto rounds = received_["capture/input"].size();
  const auto submitted = engine_.submitted;
  bus::Publisher state(peer_);
  ASSERT_TRUE(until([&] {
    state.publish(topics::kGridState,
                  [](auto& builder, auto header) { return wire::CreateGridState(builder, header); });
    return received_["capture/input"].size() > rounds;
  }));
  EXPECT_EQ(engine_.submitted, submitted) << "from the frames that the bridge has";
}

TEST_F(CaptureBridgeTest, ATrainerThatMissedTheViewsGetsThemAgain) {
  settle();
  bus::Publisher stats(peer_);
  const auto inputs = references(CameraRole::Input).size();
  ASSERT_TRUE(until([&] {
    stats.publish(topics::kTrainerStats,
                  [](auto& builder, auto header) { return wire::CreateTrainerStats(builder, header); });
    return references(CameraRole::Input).size() >= inputs + 4 && references(CameraRole::Reference).size() >= 4;
  }));
}

/// Input pictures come once. That others come all the while says nothing of them.
TEST_F(CaptureBridgeTest, ATrainerThatLostTheInputViewsGetsThemThoughReferencesComeAtARate) {
  settle();
  bus::Publisher stats(peer_);
  const auto say = [&](std::uint32_t inputs) {
    stats.publish(topics::kTrainerStats, [&](auto& builder, auto header) {
      wire::TrainerStatsBuilder body(builder);
      body.add_header(header);
      body.add_ready_references(2);
      body.add_ready_inputs(inputs);
      return body.Finish();
    });
  };
  say(4);
  const auto inputs = references(CameraRole::Input).size();
  const Camera reference = from_wire(*references(CameraRole::Reference).front()->camera());
  auto due = std::chrono::steady_clock::now();
  EXPECT_TRUE(until([&] {
    if (std::chrono::steady_clock::now() >= due) {
      due += 100ms;
      engine_.submit(reference, wire::EngineBuffer::Color, 1);
      say(0);
    }
    return references(CameraRole::Input).size() >= inputs + 4;
  }));
  EXPECT_GT(references(CameraRole::Reference).size(), 4U);
}

}  // namespace
}  // namespace splatbus::capture_bridge::test

// What the bridge makes of an engine that answers.
#include "bridge_fixture.h"
#include "wire/scene_generated.h"

namespace splatbus::capture_bridge::test {
namespace {

TEST_F(CaptureBridgeTest, TurnsAnEnginesFramesIntoSamplesAndViews) {
  engine_.objects[AnalyticScene::kBall] = Rigid{.translation = {1, 2, 3}};
  settle();
  const bus::Message& message = received_["capture/input"].front();
  const auto& input = message.root<wire::CaptureInput>();
  ASSERT_EQ(input.cameras()->size(), 4U);
  ASSERT_EQ(input.scene()->objects()->size(), 2U) << "the ball and the far field";
  EXPECT_EQ(input.scene()->objects()->Get(1)->id(), kFarFieldFrame);
  EXPECT_EQ(input.scene()->objects()->Get(1)->flags(), wire::ObjectFlags::Emissive);
  EXPECT_GT(input.rig_generation(), 0U);
  EXPECT_EQ(message.header().capture_ns(), 1234);
  const auto position = message.tensor("position", bus::ElementType::F32, {0, 3});
  ASSERT_TRUE(position);
  const std::uint32_t n = position->dim(0);
  EXPECT_GT(n, 200U);
  for (const char* name : {"normal", "albedo", "color"})
    EXPECT_TRUE(message.tensor(name, bus::ElementType::F32, {n, 3}));
  EXPECT_TRUE(message.tensor("spacing", bus::ElementType::F32, {n}));
  EXPECT_TRUE(message.tensor("object_id", bus::ElementType::U32, {n}));

  const bus::Message& view = received_["capture/reference"].front();
  const auto& reference = view.root<wire::CaptureReference>();
  const std::uint32_t size = reference.camera()->width();
  EXPECT_TRUE(view.tensor("color", bus::ElementType::U8, {size, size, 4}));
  EXPECT_TRUE(view.tensor("albedo", bus::ElementType::U8, {size, size, 4}));
  EXPECT_EQ(view.header().tensors()->Get(0)->span()->slab(), view.header().tensors()->Get(1)->span()->slab());
  ASSERT_FALSE(received_["scene/state"].empty());
  const std::uint64_t version = received_["scene/state"].front().root<wire::SceneUpdate>().scene()->version();
  EXPECT_GT(version, 0U);
  for (const bus::Message& picture : received_["capture/reference"]) {
    EXPECT_EQ(picture.root<wire::CaptureReference>().scene()->version(), version);
  }
  EXPECT_EQ(input.scene()->version(), version);
}

TEST_F(CaptureBridgeTest, ObjectIdsPassWithAllTheirBits) {
  engine_.scene.first_object_id = 0xFF000000;
  settle();
  const auto ids = received_["capture/input"].front().tensor("object_id", bus::ElementType::U32, {0});
  ASSERT_TRUE(ids);
  std::set<std::uint32_t> seen(ids->as<std::uint32_t>().begin(), ids->as<std::uint32_t>().end());
  const std::uint32_t first = engine_.scene.first_object_id;
  EXPECT_EQ(seen,
            (std::set{first + AnalyticScene::kFloor, first + AnalyticScene::kBall, first + AnalyticScene::kSheet}));
}

TEST_F(CaptureBridgeTest, ReferencesSayWhoShowsWhereOnceSomethingIsNotToBeModelled) {
  engine_.objects[AnalyticScene::kBall] = Rigid{.translation = {1, 2, 3}};
  settle();
  for (const bus::Message& picture : received_["capture/reference"]) EXPECT_FALSE(picture.announces("object_id"));
  engine_.objects[AnalyticScene::kBall].modelled = false;
  received_.clear();
  look_from(look_at({2, 1.6F, 3.4F}, {2, 0.25F, 0}, 64, 64, 1));  // inputs come anew, and tell
  ASSERT_TRUE(until([&] {
    return references(CameraRole::Reference).size() >= 2 && references(CameraRole::Input).size() >= 4 &&
           !received_["capture/input"].empty();
  }));
  for (const bus::Message& picture : received_["capture/reference"]) {
    const auto& reference = picture.root<wire::CaptureReference>();
    if (reference.retire()) continue;
    const std::uint32_t size = reference.camera()->width();
    EXPECT_TRUE(picture.tensor("object_id", bus::ElementType::U32, {size, size}));
  }
  const auto ids = received_["capture/input"].back().tensor("object_id", bus::ElementType::U32, {0});
  ASSERT_TRUE(ids);
  EXPECT_EQ(std::ranges::count(ids->as<std::uint32_t>(), AnalyticScene::kBall), 0);
}

TEST_F(CaptureBridgeTest, AStillSceneIsCapturedOnce) {
  settle();
  const auto stand = [&] { look_from(look_at({0, 1, 3.3F}, {0, 0.25F, 0}, 64, 64, 1)); };
  const auto generation = last_input().rig_generation();
  ASSERT_TRUE(until([&] {
    stand();
    return last_input().rig_generation() > generation && last_input().cameras()->size() == 4 &&
           references(CameraRole::Reference).size() == 4;
  }));
  const auto submitted = engine_.submitted;
  for (int i = 0; i < 50; ++i) {
    stand();
    ASSERT_TRUE(until([] { return true; }));
  }
  EXPECT_EQ(engine_.submitted, submitted);
  EXPECT_EQ(received_["scene/state"].size(), 1U);
}

TEST_F(CaptureBridgeTest, NothingStarvesWhileViewerSunAndObjectsMove) {
  set("reference_refresh_hz", "1000");
  set("input_refresh_hz", "1000");
  settle();
  received_.clear();
  // An engine that renders two pictures a frame, those that were asked for first, and takes three frames for each.
  constexpr int kFrames = 600, kDelay = 3, kPicturesAFrame = 2;
  std::map<std::uint64_t, int> asked;  // request ids, in which frame
  engine_.lose = [](const Camera&) { return true; };
  Camera unasked = look_at({0, 2, 2}, {0, 0, 0}, 8, 8, 1);
  unasked.role = CameraRole::Probe;
  unasked.id = 1'000'000;
  int probes = 0;
  for (int frame = 0; frame < kFrames; ++frame) {
    const float t = static_cast<float>(frame);
    look_from(look_at({20 * std::sin(0.1F * t), 1.6F, 3.4F}, {20 * std::sin(0.1F * t), 0.25F, 0}, 64, 64, 1));
    engine_.light.sun_direction = {std::sin(0.01F * t), std::cos(0.01F * t), 0};
    engine_.objects[AnalyticScene::kBall] = Rigid{.translation = {0.01F * t, 0, 0}};
    if (frame % 30 == 0) ask_probe(static_cast<std::uint64_t>(++probes), look_at({0, 2, 2}, {0, 0, 0}, 24, 20, 1));
    ASSERT_TRUE(until([] { return true; }));
    std::map<std::uint64_t, int> still;
    int rendered = 0;
    for (const auto& request : engine_.requests()) {
      const auto before = asked.find(request.id);
      const int first = before == asked.end() ? frame : before->second;
      still[request.id] = first;
      if (first < 0 || frame - first < kDelay || rendered >= kPicturesAFrame) continue;
      engine_.submit(request.camera, request.buffers, request.id);
      still[request.id] = -1;
      ++rendered;
    }
    asked = std::move(still);
    // Nobody has asked for it: it tells that the bridge has had all of the frame.
    const std::uint64_t had = bridge_->counters().frames;
    engine_.submit(unasked, wire::EngineBuffer::Color, 0);
    ASSERT_TRUE(until([&] { return bridge_->counters().frames > had + static_cast<std::uint64_t>(rendered); }));
  }
  ASSERT_TRUE(until([&] { return !received_["capture/input"].empty(); }));
  std::map<std::uint32_t, int> of_reference;
  std::set<std::uint64_t> rigs, answered;
  for (const auto* picture : references(CameraRole::Reference)) ++of_reference[picture->camera()->id()];
  for (const bus::Message& round : received_["capture/input"]) {
    const auto& input = round.root<wire::CaptureInput>();
    if (input.cameras()->size() == 4) rigs.insert(input.rig_generation());
  }
  for (const bus::Message& probe : received_["capture/probe"]) {
    answered.insert(probe.root<wire::CaptureProbe>().probe_id());
  }
  EXPECT_EQ(of_reference.size(), 2U);
  for (const auto& [camera, pictures] : of_reference) EXPECT_GE(pictures, 20) << camera;
  EXPECT_GE(rigs.size(), 15U);
  EXPECT_GE(answered.size(), static_cast<std::size_t>(probes - 1));
  EXPECT_GT(references(CameraRole::Reference).back()->scene()->version(),
            references(CameraRole::Reference).front()->scene()->version() + 100);
}

TEST_F(CaptureBridgeTest, WhatIsRenderedAgainIsSampledByItself) {
  set("input_refresh_hz", "1000");
  settle();
  const std::size_t whole = last_input().cameras()->size();
  ASSERT_GT(whole, 1U);
  received_.clear();
  const std::uint32_t shown = 2;
  engine_.lose = [](const Camera& camera) { return camera.role == CameraRole::Input && camera.id != shown; };
  engine_.objects[AnalyticScene::kBall] = Rigid{.translation = {0.1F, 0, 0}};
  ask_probe(1, look_at({0, 2, 2}, {0, 0, 0}, 24, 20, 1));  // by whose picture the bridge hears of it
  ASSERT_TRUE(until([&] { return !received_["capture/input"].empty(); }));
  ASSERT_EQ(last_input().cameras()->size(), 1U);
  EXPECT_EQ(last_input().cameras()->Get(0)->id(), shown);
}

TEST_F(CaptureBridgeTest, AViewerThatMovesTakesTheInputRigAlong) {
  settle();
  const std::uint64_t generation = last_input().rig_generation();
  look_from(look_at({2, 1.6F, 3.4F}, {2, 0.25F, 0}, 64, 64, 1));
  ASSERT_TRUE(until([&] { return last_input().rig_generation() > generation && last_input().cameras()->size() == 4; }));
  glm::vec3 middle(0);
  for (const wire::Camera* camera : *last_input().cameras()) middle += from_wire(*camera).world_from_camera.translation;
  EXPECT_GT((middle / 4.0F).x, 1.0F);
}

TEST_F(CaptureBridgeTest, ProbesAreEachAnsweredOnce) {
  settle();
  const Camera camera = look_at({0, 2, 2}, {0, 0, 0}, 24, 20, 1);
  for (std::uint64_t id = 10; id < 15; ++id) ask_probe(id, camera);
  ask_probe(12, camera);
  ASSERT_TRUE(until([&] { return received_["capture/probe"].size() >= 5 && bridge_->cameras() == 7; }));
  std::multiset<std::uint64_t> answered;
  for (const bus::Message& message : received_["capture/probe"]) {
    answered.insert(message.root<wire::CaptureProbe>().probe_id());
    EXPECT_TRUE(message.tensor("color", bus::ElementType::U8, {20, 24, 4}));
    EXPECT_TRUE(message.tensor("object_id", bus::ElementType::U32, {20, 24}));
    EXPECT_TRUE(message.tensor("depth", bus::ElementType::F32, {20, 24}));
  }
  for (std::uint64_t id = 10; id < 15; ++id) EXPECT_GE(answered.count(id), 1U) << id;
  EXPECT_LE(answered.size(), 6U) << "12 may be asked again once it was answered";
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
      if (message->topic() != topics::kSceneLightDepth.name) continue;
      const auto depth = message->tensor("light_depth", bus::ElementType::F32, {16, 16});
      EXPECT_TRUE(depth && depth->as<float>()[0] == 7.0F);
      EXPECT_NE(message->header().tensors()->Get(0)->span()->slab(),
                received_["capture/reference"].front().header().tensors()->Get(0)->span()->slab());
    }
    return topics.size() == 2;
  }));
}

TEST_F(CaptureBridgeTest, ChangesOfLightAndObjectsAreNumbered) {
  settle();
  Camera camera = look_at({0, 2, 2}, {0, 0, 0}, 16, 16, 1);
  camera.role = CameraRole::Reference;
  camera.id = 77;
  const auto version_of = [](const auto* body) { return body->scene()->version(); };
  const auto state = [&](std::size_t n) { return received_["scene/state"].at(n).root<wire::SceneUpdate>().scene(); };
  engine_.objects[5] = Rigid{.translation = {1, 1, 1}};
  engine_.submit(camera, wire::EngineBuffer::Color, 0);
  ASSERT_TRUE(until([&] { return received_["scene/state"].size() == 2; }));
  EXPECT_GT(state(1)->version(), state(0)->version());
  EXPECT_EQ(from_wire(*state(1)).objects.at(5).rigid.translation, glm::vec3(1));
  ASSERT_TRUE(until([&] { return version_of(references(CameraRole::Reference).back()) == state(1)->version(); }));
  engine_.light.generation = 2;
  engine_.light.sun_irradiance = {2, 2, 2};
  engine_.submit(camera, wire::EngineBuffer::Color, 0);
  ASSERT_TRUE(until([&] { return received_["scene/state"].size() == 3; }));
  EXPECT_GT(state(2)->version(), state(1)->version());
  EXPECT_EQ(from_wire(*state(2)).light.sun_irradiance, glm::vec3(2));
  ASSERT_TRUE(until([&] { return version_of(references(CameraRole::Reference).back()) == state(2)->version(); }));
  // One that no camera was due in.
  engine_.light.sun_irradiance = {3, 3, 3};
  const std::size_t before = references(CameraRole::Reference).size();
  const std::uint64_t lost_before = bridge_->counters().frames_lost;
  engine_.submit_scene();
  ASSERT_TRUE(until([&] { return received_["scene/state"].size() == 4; }));
  EXPECT_EQ(from_wire(*state(3)).light.sun_irradiance, glm::vec3(3));
  EXPECT_EQ(bridge_->counters().frames_lost, lost_before);
  EXPECT_EQ(references(CameraRole::Reference).size(), before);
  // A frame from before, late: the newest state stands, and its picture has no version.
  const std::size_t pictures = references(CameraRole::Reference).size();
  engine_.frame = 0;
  engine_.objects.clear();
  engine_.submit(camera, wire::EngineBuffer::Color, 0);
  const auto lost = bridge_->counters().frames_lost;
  ASSERT_TRUE(until([&] { return bridge_->counters().frames_lost > lost; }));
  EXPECT_EQ(received_["scene/state"].size(), 4U);
  EXPECT_EQ(references(CameraRole::Reference).size(), pictures);
}

}  // namespace
}  // namespace splatbus::capture_bridge::test

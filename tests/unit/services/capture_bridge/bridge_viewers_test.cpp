// The bridge among viewers who walk, jump and leave, in a scene with walls.
#include "bridge_fixture.h"
#include "wire/model_generated.h"

namespace splatbus::capture_bridge::test {

class BridgeViewersTest : public CaptureBridgeTest {
 protected:
  void look_as(const std::string& viewer, const Camera& camera) {
    publisher_.publish(topics::kViewerPose, [&](auto& builder, auto header) {
      const wire::Camera out = to_wire(camera);
      return wire::CreateViewerPoseDirect(builder, header, viewer.c_str(), &out);
    });
  }
  /// Cameras of the newest rounds, by rig generation.
  [[nodiscard]] std::vector<glm::vec3> newest_round_about(const glm::vec3& place, float metres) {
    const auto& rounds = received_["capture/input"];
    for (std::size_t back = 1; back <= rounds.size(); ++back) {
      std::vector<glm::vec3> stands;
      for (const wire::Camera* camera : *rounds[rounds.size() - back].root<wire::CaptureInput>().cameras()) {
        stands.push_back(from_wire(*camera).world_from_camera.translation);
      }
      const bool near =
          std::ranges::all_of(stands, [&](const glm::vec3& eye) { return glm::distance(eye, place) < metres; });
      if (near) return stands;
    }
    return {};
  }
};

TEST_F(BridgeViewersTest, InARoomNoInputCameraStandsInAWallOrBehindOne) {
  set("input_cameras", "16");
  set("input_blind_m", "0");
  set("reference_cameras", "3");
  const glm::vec3 middle(20, 0, 0);
  engine_.scene.boxes = room(middle, false);
  start();
  const glm::vec3 eye = middle + glm::vec3(0.5F, 1.5F, 1.6F);  // its right is in the wall
  std::vector<glm::vec3> stands;
  ASSERT_TRUE(until([&] {
    look_as("walker", look_at(eye, eye + glm::vec3(1, -0.1F, 0.2F), 64, 64, 1));
    stands = newest_round_about(eye, 9);
    return stands.size() == 16;
  }));
  for (const glm::vec3& place : stands) {
    const glm::vec3 way = place - eye;
    if (glm::length(way) < 1e-3F) continue;  // the viewer's own place
    const auto hit = engine_.scene.cast(eye, glm::normalize(way));
    EXPECT_TRUE(!hit || hit->distance > glm::length(way)) << place.x << " " << place.y << " " << place.z;
  }
  const auto inside = [&](const FakeEngine::Request& request) {
    const glm::vec3 at = request.camera.world_from_camera.translation - middle;
    return request.camera.role != CameraRole::Reference || std::max(std::abs(at.x), std::abs(at.z)) < 2;
  };
  EXPECT_TRUE(until([&] { return std::ranges::all_of(engine_.requests(), inside); })) << "nor does a reference";
  EXPECT_GE(bridge_->counters().ranges, 6U);
  EXPECT_LE(bridge_->counters().ranges, 12U) << "bounded";
  EXPECT_TRUE(until([&] { return engine_.requested(CameraRole::Probe) == 0; })) << "and asked for no longer";
}

TEST_F(BridgeViewersTest, AnEngineWithoutDepthCubesIsNotWaitedFor) {
  engine_.lose = [](const Camera& camera) { return camera.role == CameraRole::Probe; };
  start();
  ASSERT_TRUE(until([&] {
    look_as("walker", look_at({20, 1.6F, 0}, {19, 1.5F, 0}, 64, 64, 1));
    return newest_round_about({16.6F, 1.4F, 0}, 4).size() == 4;
  }));
}

TEST_F(BridgeViewersTest, WhatAViewerSeesNextIsSampledBeforeTheRoundIsThere) {
  set("input_range_hz", "0");
  set("input_lead_s", "0");
  set("input_deadline_s", "60");
  set("sample_budget", "400");
  const glm::vec3 eye(0, 1.6F, 3);
  const auto at_eye = [&](const Camera& camera) {
    return glm::distance(camera.world_from_camera.translation, eye) < 1e-3F;
  };
  engine_.lose = [&](const Camera& camera) { return camera.role == CameraRole::Input && !at_eye(camera); };
  start();
  ASSERT_TRUE(until([&] {
    look_as("walker", look_at(eye, {0, 0.2F, 0}, 64, 64, 1));
    return !received_["capture/input"].empty();
  }));
  const wire::CaptureInput& glance = last_input();
  ASSERT_EQ(glance.cameras()->size(), 1U);
  EXPECT_TRUE(at_eye(from_wire(*glance.cameras()->Get(0))));
  const auto samples = received_["capture/input"].back().tensor("object_id", bus::ElementType::U32, {0});
  ASSERT_TRUE(samples);
  EXPECT_GT(samples->shape()[0], 50U);
  EXPECT_LE(samples->shape()[0], 100U) << "a quarter of the budget: all of the dome's are to come";
  EXPECT_EQ(bridge_->counters().glances, 1U);
}

TEST_F(BridgeViewersTest, BlindPicturesGoNowhereAndTheirPlaceIsTriedElsewhere) {
  // A block that fills the upper part of the dome about the place of interest.
  engine_.scene.boxes = {{{-9, 2.4F, -9}, {9, 2.6F, 9}}};
  set("input_blind_m", "0.3");
  set("input_cameras", "12");
  start();
  ASSERT_TRUE(until([&] { return !received_["capture/input"].empty(); }));
  EXPECT_GT(bridge_->counters().inputs_blind, 0U);
  for (const bus::Message& message : received_["capture/reference"]) {
    const auto& picture = message.root<wire::CaptureReference>();
    if (picture.camera()->role() != wire::CameraRole::Input) continue;
    const glm::vec3 eye = from_wire(*picture.camera()).world_from_camera.translation;
    EXPECT_FALSE(engine_.scene.boxes[0].holds(eye));
  }
}

TEST_F(BridgeViewersTest, TwoViewersAHundredMetresApartHaveTheirRoundsAndViews) {
  set("input_cameras", "8");
  set("input_range_hz", "10");
  start();
  const Camera a = look_at({0, 1.6F, 3}, {0, 0.2F, 0}, 64, 64, 1),
               b = look_at({100, 1.6F, 3}, {100, 0.2F, 0}, 64, 64, 1);
  engine_.scene.boxes = {{{95, -0.2F, -5}, {105, 0, 5}}};
  ASSERT_TRUE(until([&] {
    look_as("a", a);
    look_as("b", b);
    return newest_round_about(a.world_from_camera.translation, 8).size() == 4 &&
           newest_round_about(b.world_from_camera.translation, 8).size() == 4;
  }));
  const auto aligned = [&](const Camera& viewer) {
    return std::ranges::any_of(references(CameraRole::Reference), [&](const auto* picture) {
      const glm::vec3 eye = from_wire(*picture->camera()).world_from_camera.translation;
      return glm::distance(eye, viewer.world_from_camera.translation) < 1e-4F;
    });
  };
  EXPECT_TRUE(until([&] {
    look_as("a", a);
    look_as("b", b);
    return aligned(a) && aligned(b);
  }));
  EXPECT_EQ(bridge_->viewers(), 2U);
  EXPECT_EQ(engine_.requested(CameraRole::Reference), 2U);
  EXPECT_EQ(engine_.requested(CameraRole::Input), 8U);
}

TEST_F(BridgeViewersTest, TwoViewersShareTheSamplesAsTheyShareTheCameras) {
  set("input_cameras", "8");
  set("input_range_hz", "0");
  set("input_deadline_s", "60");  // no round of some of its pictures
  set("sample_budget", "400");
  start();
  const Camera a = look_at({0, 1.6F, 3}, {0, 0.2F, 0}, 64, 64, 1), b = look_at({3, 1.6F, 0}, {0, 0.2F, 0}, 64, 64, 1);
  ASSERT_TRUE(until([&] {
    look_as("a", a);
    look_as("b", b);
    return newest_round_about(a.world_from_camera.translation, 8).size() == 4 &&
           newest_round_about(b.world_from_camera.translation, 8).size() == 4;
  }));
  std::size_t rounds = 0;
  for (const bus::Message& message : received_["capture/input"]) {
    if (message.root<wire::CaptureInput>().cameras()->size() != 4) continue;
    const auto samples = message.tensor("object_id", bus::ElementType::U32, {0});
    if (!samples) continue;
    ++rounds;
    EXPECT_GT(samples->dim(0), 150U);
    EXPECT_LE(samples->dim(0), 200U) << "half of the cameras, half of the budget";
  }
  EXPECT_GT(rounds, 0U);
}

TEST_F(BridgeViewersTest, WhereTheExpanderFindsNothingNewFewerInputCamerasGo) {
  set("input_cameras", "16");
  set("input_range_hz", "0");
  set("input_lead_s", "0");
  engine_.scene.boxes = {{{95, -0.2F, -5}, {105, 0, 5}}};
  start();
  const auto look = [&](float a, float b) {
    look_as("a", look_at({a, 1.6F, 3}, {a, 0.2F, 0}, 64, 64, 1));
    look_as("b", look_at({b, 1.6F, 3}, {b, 0.2F, 0}, 64, 64, 1));
  };
  const auto cameras_about = [&](float x) {
    return std::ranges::count_if(engine_.requests(), [&](const FakeEngine::Request& request) {
      return request.camera.role == CameraRole::Input &&
             std::abs(request.camera.world_from_camera.translation.x - x) < 9;
    });
  };
  const auto say_all_are_processed = [&] {
    const std::uint64_t rounds = received_["capture/input"].size();  // glances of eyes among them
    publisher_.publish(topics::kGridState, [&](auto& builder, auto header) {
      return wire::CreateGridState(builder, header, 0.1F, rounds);
    });
  };
  const auto generation_about = [&](float x) {
    std::uint64_t newest = 0;
    for (const bus::Message& message : received_["capture/input"]) {
      const auto& input = message.root<wire::CaptureInput>();
      if (input.cameras()->size() < 8) continue;
      const bool near = std::abs(from_wire(*input.cameras()->Get(0)).world_from_camera.translation.x - x) < 9;
      if (near) newest = std::max(newest, input.rig_generation());
    }
    return newest;
  };
  ASSERT_TRUE(until([&] {
    look(0, 100);
    return generation_about(0) > 0 && generation_about(100) > 0;
  }));
  say_all_are_processed();
  const std::uint64_t before = generation_about(0);
  ASSERT_TRUE(until([&] {
    look(1, 100);
    return generation_about(0) > before;
  }));
  // The round that a's step has brought is processed, and brought no Gaussian.
  say_all_are_processed();
  // Both walk to and fro: cameras are shared anew with a step, and steps may be heard before what was said is.
  float way_m = 1, step_m = 0.05F;
  EXPECT_TRUE(until([&] {
    if (way_m + step_m < 1 || way_m + step_m > 5) step_m = -step_m;
    way_m += step_m;
    look(1 + way_m, 100 + way_m);
    return cameras_about(0) < 8 && cameras_about(100) > 8;
  }));
}

TEST_F(BridgeViewersTest, WhoJumpsHasAWholeRoundThereWithoutTheOldOnes) {
  set("input_deadline_s", "60");
  start();
  const auto stand = [&](float x) { look_as("v", look_at({x, 1.6F, 3}, {x, 0.2F, 0}, 64, 64, 1)); };
  ASSERT_TRUE(until([&] {
    stand(0);
    return newest_round_about({0, 1.6F, 3}, 8).size() == 4 && engine_.requested(CameraRole::Probe) == 0;
  }));
  // Pictures of the next place never come, and nobody waits for them.
  engine_.lose = [](const Camera& camera) {
    return camera.role == CameraRole::Input && camera.world_from_camera.translation.x < 20;
  };
  for (int i = 0; i < 20; ++i) {
    stand(0.1F * static_cast<float>(i));
    ASSERT_TRUE(until([] { return true; }));
  }
  ASSERT_TRUE(until([&] {
    stand(50);
    return newest_round_about({50, 1.6F, 3}, 8).size() == 4;
  }));
}

}  // namespace splatbus::capture_bridge::test

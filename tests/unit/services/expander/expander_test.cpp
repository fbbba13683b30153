// The service against a trainer and a capture-bridge of the test's own.
#include <limits>

#include "expander_fixture.h"
#include "room_scene.h"

namespace splatbus::expander::test {
namespace {

TEST_P(ExpanderTest, InsertsARoundOnceInBoundedBatches) {
  start();
  const InputSamples round = floor_round(-1, 1);
  publish_input(round);
  ASSERT_TRUE(settled_after(1));
  EXPECT_EQ(trainer_->points.size(), round.size());
  EXPECT_EQ(distinct_points(), round.size());
  EXPECT_EQ(trainer_->batches.size(), (round.size() + 499) / 500);
  EXPECT_EQ(state().gaussians_inserted(), round.size());
  EXPECT_EQ(state().cells_seen(), state().cells_modelled());
  EXPECT_EQ(state().cells()->size(), state().cells_modelled());
  publish_input(round);
  ASSERT_TRUE(settled_after(2));
  EXPECT_EQ(trainer_->points.size(), round.size());
}

TEST_P(ExpanderTest, RepeatsWhatIsNotAcknowledged) {
  start();
  trainer_->deaf = true;
  publish_input(floor_round(-1, 1));
  ASSERT_TRUE(until([&] { return trainer_->received >= 12; })) << "4 batches, three times";
  EXPECT_EQ(expander_->ledger().pending(), 4U);
  trainer_->deaf = false;
  ASSERT_TRUE(settled_after(1));
  EXPECT_EQ(trainer_->points.size(), 1600U);
}

TEST_P(ExpanderTest, ARestartedExpanderDoesNotDoubleTheModel) {
  start();
  const InputSamples round = floor_round(-1, 1);
  publish_input(round);
  ASSERT_TRUE(settled_after(1));
  expander_.reset();
  start();
  EXPECT_EQ(expander_->follower().adoptions(), 1U);
  EXPECT_EQ(expander_->mapper().modelled_points(), round.size());
  publish_input(floor_round(-1, 1.5F));
  ASSERT_TRUE(settled_after(1));
  EXPECT_EQ(trainer_->points.size(), 2500U);
  EXPECT_EQ(distinct_points(), 2500U);
}

TEST_P(ExpanderTest, ARestartedExpanderKnowsMovingObjectsAndLeavesOutGarbage) {
  start();
  RoomScene scene;
  publish_input(room_round(scene, 3, 32));
  ASSERT_TRUE(settled_after(1));
  const std::size_t inserted = trainer_->points.size();
  ASSERT_GT(inserted, 2000U);
  for (const float x : {std::numeric_limits<float>::quiet_NaN(), 1e30F}) {
    trainer_->points.emplace_back(x, 0, 0);
    trainer_->normal.emplace_back(0, 1, 0);
    trainer_->cell.push_back(~0ULL);
    trainer_->object_id.push_back(RoomScene::kBall);
  }
  trainer_->publish();
  expander_.reset();
  start();
  EXPECT_EQ(expander_->follower().adoptions(), 1U);
  EXPECT_EQ(expander_->mapper().modelled_points(), inserted);
  publish_input(room_round(scene, 3, 32));
  ASSERT_TRUE(settled_after(1));
  EXPECT_EQ(expander_->ledger().gaussians(), 0U) << "all of it is there";
}

TEST_P(ExpanderTest, ATrainerThatLostItsModelGetsItAgain) {
  start();
  publish_input(floor_round(-1, 1));
  ASSERT_TRUE(settled_after(1));
  start_trainer();
  ASSERT_TRUE(until([&] { return trainer_->points.size() == 1600; }));
  ASSERT_TRUE(until([&] { return state().batches_pending() == 0; }));
  EXPECT_EQ(distinct_points(), 1600U);
}

TEST_P(ExpanderTest, WaitsForTheTrainerToSayWhatItHas) {
  trainer_.reset();
  expander_ = std::make_unique<Expander>(connect("another-bus-name"), parameters_, GetParam().backend);
  // The broker holds what the first trainer said: the expander is settled by it without any trainer alive.
  ASSERT_TRUE(until([&] { return expander_->follower().settled(); }));
}

TEST_P(ExpanderTest, BrokenInputIsRefusedAndNothingElseDisturbed) {
  start();
  InputSamples nan = floor_round(-1, 0);
  for (auto& position : nan.position) position.x = std::numeric_limits<float>::quiet_NaN();
  publish_input(nan);
  InputSamples cameras = floor_round(-1, 0);
  cameras.cameras.push_back(cameras.cameras[0]);
  cameras.depth_m.resize(cameras.depth_m.size() * 2);
  for (auto& index : cameras.camera) index = 7;
  publish_input(cameras);
  // A wrong schema; tensors that disagree; no tensors at all.
  publisher_.publish(Topic<wire::CaptureInput>{"capture/input", false, kSchema<wire::ViewerPose>},
                     [&](auto& builder, auto header) {
                       return wire::CreateCaptureInput(builder, header, 0, 0, to_wire(builder, SceneState{}));
                     });
  publisher_.publish(topics::kCaptureInput, [&](auto& builder, auto header) {
    return wire::CreateCaptureInput(builder, header, 0, 0, to_wire(builder, SceneState{}));
  });
  const std::vector<float> few(30);
  const std::vector<bus::OutgoingTensor> lying{{.name = "position", .shape = {10, 3}, .inline_data = few.data()}};
  publisher_.publish(topics::kCaptureInput, {.tensors = lying}, [&](auto& builder, auto header) {
    return wire::CreateCaptureInput(builder, header, 0, 0, to_wire(builder, SceneState{}));
  });
  publisher_.publish(Topic<wire::ModelPublished>{"model/published"}, [&](auto& builder, auto header) {
    return wire::CreateModelPublished(builder, header, 5, 1000, 2000);
  });
  const InputSamples round = floor_round(-1, 1);
  publish_input(round);
  ASSERT_TRUE(until([&] { return trainer_->points.size() == round.size(); }));
  EXPECT_EQ(expander_->counters().samples_dropped, nan.size() + cameras.size());
}

TEST_P(ExpanderTest, CountsWhatPassesThroughTheHost) {
  start();
  publish_input(floor_round(-1, 1));
  ASSERT_TRUE(settled_after(1));
  expander_.reset();
  start();  // which adopts the model
  publish_input(floor_round(-1, 1.5F));
  ASSERT_TRUE(settled_after(1));
  const bool on_device = GetParam().backend == Device::Cuda && GetParam().peers == Device::Cuda;
  EXPECT_EQ(expander_->mapper().host_copied_bytes() == 0, on_device);
}

TEST_P(ExpanderTest, AFullRoundIsInsertedAtOnce) {
  set("batch_size", "5000");
  set("resend_s", "60");
  start();
  trainer_->deaf = true;  // three batches do not wait for an answer
  bus::Subscriber inserts(peer_, {"model/insert"});
  ASSERT_TRUE(inserts.wait_connected(bus_test::patience));
  publish_input(room_round({}, 10, 40));
  std::size_t inserted = 0;
  ASSERT_TRUE(bus_test::eventually([&] {
    expander_->step(0ms);
    while (auto message = inserts.receive(0ms)) inserted += message->tensor("cell")->dim(0);
    return inserted > 0 && inserted == expander_->ledger().gaussians();
  }));
  EXPECT_GT(inserted, 10000U);
  EXPECT_GT(expander_->counters().latency_milliseconds, 0);
}

TEST_P(ExpanderTest, StopsAtTheMostGaussians) {
  set("max_gaussians", "700");
  start();
  publish_input(floor_round(-1, 1));
  ASSERT_TRUE(settled_after(1));
  EXPECT_EQ(trainer_->points.size(), 700U);
}

TEST_P(ExpanderTest, IsReadyForRoundsThatMakeACellSeen) {
  // The least that may be asked for: a device is made ready with a round of so many samples, which must insert.
  EXPECT_NE(parameters_.set("usual_samples", "63", false), "");
  ASSERT_EQ(parameters_.set("usual_samples", "64", false), "");
  start();
  publish_input(floor_round(-1, 1));
  ASSERT_TRUE(settled_after(1));
  EXPECT_EQ(trainer_->points.size(), 1600U);
}

}  // namespace
}  // namespace splatbus::expander::test

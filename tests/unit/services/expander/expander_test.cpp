// The service against a trainer and a capture-bridge of the test's own.
#include <sys/resource.h>
#include <unistd.h>

#include <fstream>
#include <limits>

#include "expander_fixture.h"
#include "room_scene.h"

namespace splatbus::expander::test {
namespace {

TEST_P(ExpanderTest, InsertsARoundOnceInBoundedBatches) {
  start();
  const HostRound round = floor_round(-1, 1);
  publish_input(round);
  ASSERT_TRUE(settled_after(1));
  EXPECT_EQ(trainer_->points.size(), round.size());
  EXPECT_EQ(distinct_points(), round.size());
  EXPECT_EQ(trainer_->batches.size(), (round.size() + 499) / 500);
  EXPECT_EQ(state().gaussians_inserted(), round.size());
  EXPECT_EQ(state().cells_seen(), state().cells_modelled());
  EXPECT_EQ(told_.size(), state().cells_modelled());
  publish_input(round);
  ASSERT_TRUE(settled_after(2));
  EXPECT_EQ(trainer_->points.size(), round.size());
}

/// A surface that is seen more finely is filled as densely as there are steps to train it.
TEST_P(ExpanderTest, ASlowOptimizerGetsFewerGaussians) {
  std::map<double, std::size_t> added;
  for (const double steps_per_s : {0.0, 1.0, 30.0}) {
    start_trainer();
    start();
    publish_input(floor_round(-1, 1));
    ASSERT_TRUE(settled_after(1));
    const std::size_t before = trainer_->points.size();
    publisher_.publish(topics::kTrainerStats, [&](flatbuffers::FlatBufferBuilder& builder, auto header) {
      return wire::CreateTrainerStats(builder, header, 1, 1, 1, steps_per_s);
    });
    HostRound finer = floor_round(-1, 1, 0.2F);
    for (float& spacing_m : finer.spacing_m) spacing_m *= 0.5F;
    publish_input(finer);
    ASSERT_TRUE(settled_after(2));
    added[steps_per_s] = trainer_->points.size() - before;
    expander_.reset();
    trainer_.reset();
  }
  EXPECT_GT(added[30], 100U);
  EXPECT_EQ(added[30], added[0]) << "while nobody knows, there is time";
  EXPECT_LT(added[1], added[30] / 2);
}

TEST_P(ExpanderTest, RepeatsWhatIsNotAcknowledged) {
  start();
  trainer_->deaf = true;
  publish_input(floor_round(-1, 1));
  ASSERT_TRUE(until([&] { return trainer_->received >= 12; })) << "4 batches, three times";
  EXPECT_EQ(expander_->queue().pending(), 4U);
  trainer_->deaf = false;
  ASSERT_TRUE(settled_after(1));
  EXPECT_EQ(trainer_->points.size(), 1600U);
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
  ASSERT_TRUE(until([&] { return expander_->model_sync().settled(); }));
}

TEST_P(ExpanderTest, BrokenInputIsRefusedAndNothingElseDisturbed) {
  start();
  HostRound nan = floor_round(-1, 0);
  for (auto& position : nan.position) position.x = std::numeric_limits<float>::quiet_NaN();
  publish_input(nan);
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
  const HostRound round = floor_round(-1, 1);
  publish_input(round);
  ASSERT_TRUE(until([&] { return trainer_->points.size() == round.size(); }));
  EXPECT_EQ(expander_->counters().samples_invalid, nan.size());
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
  EXPECT_EQ(expander_->inserter().host_copied_bytes() == 0, on_device);
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
    while (auto message = inserts.receive(0ms)) inserted += message->tensor("object_id")->dim(0);
    return inserted > 0 && inserted == expander_->queue().gaussians();
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

TEST_P(ExpanderTest, WhatTheTrainerHasRemovedIsFilledAgain) {
  start();
  const HostRound round = floor_round(-1, 1);
  publish_input(round);
  ASSERT_TRUE(settled_after(1));
  ASSERT_EQ(trainer_->points.size(), 1600U);
  remove_from(1200);
  publish_input(round);
  ASSERT_TRUE(settled_after(2));
  EXPECT_EQ(trainer_->points.size(), 1600U);
  EXPECT_EQ(distinct_points(), 1600U);
  std::size_t modelled = 0;
  for (const auto& [cell, counts] : told_) modelled += counts.second;
  EXPECT_EQ(modelled, 1600U);
  EXPECT_EQ(expander_->model_sync().adoptions(), 0U) << "the trainer is the same";
}

TEST_P(ExpanderTest, ReadsThePagesThatHaveChangedAndSearchesThoseAboutARound) {
  constexpr std::size_t kFarPages = 100;
  for (std::size_t i = 0; i < kFarPages * kPageLanes; ++i) {
    const auto page = static_cast<float>(i / kPageLanes), lane = static_cast<float>(i % kPageLanes);
    trainer_->points.emplace_back(40 + 3 * page, 0, 0.05F * lane);
    trainer_->normal.emplace_back(0, 1, 0);
    trainer_->object_id.push_back(kWorldFrame);
  }
  trainer_->publish();
  start();
  const ModelledPoints& modelled = expander_->inserter().modelled();
  ASSERT_TRUE(until([&] { return modelled.pages_read() == kFarPages; })) << modelled.pages_read();
  publish_input(floor_round(-1, 1));
  ASSERT_TRUE(settled_after(1));
  EXPECT_EQ(modelled.near_pages(), 0U);
  publish_input(floor_round(-1, 1.5F));
  ASSERT_TRUE(settled_after(2));
  EXPECT_EQ(modelled.near_pages(), 2U) << "of 1600 Gaussians";
  EXPECT_EQ(modelled.pages_read(), kFarPages + 2);
  EXPECT_EQ(modelled.size(), kFarPages * kPageLanes + 2500);
  publish_input(floor_round(-1, 1.5F));
  ASSERT_TRUE(settled_after(3));
  EXPECT_EQ(modelled.pages_read(), kFarPages + 4) << "the floor's second page has more, and there is a third";
  remove_from(kFarPages * kPageLanes + 1300);
  publish_input(floor_round(-1, 1.5F));
  ASSERT_TRUE(settled_after(4));
  EXPECT_EQ(modelled.pages_read(), kFarPages + 5) << "the second has less, and the third is gone";
  EXPECT_EQ(trainer_->points.size(), kFarPages * kPageLanes + 2500) << "the hole is filled";
  EXPECT_EQ(distinct_points(), trainer_->points.size());
}

TEST_P(ExpanderTest, CoarseSamplesFindWhatIsModelledAboutThem) {
  start();
  HostRound round = empty_round();
  for (int x = 0; x < 30; ++x) {
    for (int z = 0; z < 30; ++z) {
      add_sample(round, {static_cast<float>(x), 0, static_cast<float>(z)});
      round.spacing_m.back() = 1;
    }
  }
  publish_input(round);
  ASSERT_TRUE(settled_after(1));
  EXPECT_EQ(trainer_->points.size(), round.size());
  expander_.reset();
  start();  // which knows of pages alone
  publish_input(round);
  ASSERT_TRUE(settled_after(1));
  EXPECT_EQ(state().gaussians_inserted(), 0U);
}

TEST_P(ExpanderTest, WhatHasBeenRemovedMakesRoomBelowTheLimit) {
  set("max_gaussians", "1600");
  start();
  publish_input(floor_round(-1, 1));
  ASSERT_TRUE(settled_after(1));
  remove_from(1000);
  publish_input(floor_round(2, 3));
  ASSERT_TRUE(settled_after(2));
  EXPECT_EQ(trainer_->points.size(), 1400U);
}

TEST_P(ExpanderTest, AStateTellsOfTheCellsThatHaveChanged) {
  set("repeat_s", "1000");
  start();
  publish_input(floor_round(-1, 1));
  ASSERT_TRUE(settled_after(1));
  ASSERT_TRUE(until([&] { return told_.size() == state().cells_modelled(); }));
  const auto before = told_;
  const std::size_t told = cells_told_;
  publish_input(floor_round(2, 2.5F));
  ASSERT_TRUE(settled_after(2));
  ASSERT_TRUE(until([&] { return told_.size() == state().cells_modelled(); }));
  EXPECT_GT(told_.size(), before.size());
  EXPECT_EQ(cells_told_ - told, told_.size() - before.size()) << "the others are not said again";
  for (const auto& [cell, counts] : before) EXPECT_EQ(told_.at(cell), counts);
}

TEST_P(ExpanderTest, ALateReaderIsToldOfAllCells) {
  set("repeat_s", "0.002");
  start();
  publish_input(floor_round(-1, 1));
  ASSERT_TRUE(settled_after(1));
  ASSERT_TRUE(until([&] { return told_.size() == state().cells_modelled(); }));
  const auto before = std::exchange(told_, {});
  ASSERT_TRUE(until([&] { return told_.size() == before.size(); }));
  EXPECT_EQ(told_, before);
}

TEST_P(ExpanderTest, AStateIsBoundedAndTheRestFollows) {
  set("min_samples", "1");
  start();
  HostRound round = empty_round();
  for (int x = 0; x < 100; ++x) {
    for (int z = 0; z < 100; ++z) add_sample(round, {0.25F * static_cast<float>(x), 0, 0.25F * static_cast<float>(z)});
  }
  publish_input(round);
  ASSERT_TRUE(until([&] { return told_.size() == 10000; }));
  EXPECT_LE(largest_state_, 4096U);
  for (const auto& [cell, counts] : told_) ASSERT_EQ(counts, std::pair(1U, 1U));
}

TEST_P(ExpanderTest, RefusesARoundBeyondItsBound) {
  ASSERT_EQ(parameters_.set("max_samples", "1599", false), "");
  start();
  publish_input(floor_round(-1, 1));
  ASSERT_TRUE(until([&] { return expander_->counters().rounds_lost == 1; }));
  HostRound smaller = floor_round(-1, 1);
  smaller.resize(1599);
  publish_input(smaller);
  ASSERT_TRUE(settled_after(1));
  EXPECT_EQ(trainer_->points.size(), 1599U);
}

/// No more memory than the process has now, and a little for what goes on beside the expander.
class NoMoreMemory {
 public:
  NoMoreMemory() {
    getrlimit(RLIMIT_AS, &before_);
    std::size_t pages = 0;
    std::ifstream("/proc/self/statm") >> pages;
    rlimit limit = before_;
    limit.rlim_cur = pages * static_cast<std::size_t>(sysconf(_SC_PAGESIZE)) + (std::size_t{1} << 20U);
    setrlimit(RLIMIT_AS, &limit);
  }
  ~NoMoreMemory() { setrlimit(RLIMIT_AS, &before_); }
  NoMoreMemory(const NoMoreMemory&) = delete;
  NoMoreMemory& operator=(const NoMoreMemory&) = delete;

 private:
  rlimit before_{};
};

TEST_P(ExpanderTest, AFailureOfMemoryEndsTheStepAndTheNextProcessGoesOn) {
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
  GTEST_SKIP() << "a sanitizer has more address space than it may lose";
#endif
  if (GetParam().backend == Device::Cuda) GTEST_SKIP() << "the limit is the host's";
  start();
  publish_input(floor_round(-1, 1));
  ASSERT_TRUE(settled_after(1));
  const HostRound large = floor_round(-22, 22);  // of more bytes than malloc() ever keeps
  const std::vector<glm::vec3> padding(large.size() * 5);
  const std::vector<bus::TensorSource> sources{
      {"position", {static_cast<std::uint32_t>(padding.size()), 3}, bus::ElementType::F32, padding.data()}};
  publisher_.publish(topics::kCaptureInput, {.tensors = ring_.write(sources)}, [&](auto& builder, auto header) {
    return wire::CreateCaptureInput(builder, header, 0, 0, to_wire(builder, SceneState{}));
  });
  ASSERT_TRUE(until([&] { return expander_->counters().rounds_lost == 1; })) << "the slab of input is mapped now";
  publish_input(large);
  std::string failure;
  {
    const NoMoreMemory limit;
    try {
      for (int i = 0; i < 1000 && failure.empty(); ++i) expander_->step(5ms);
    } catch (const std::exception& error) {
      failure = error.what();
    }
  }
  EXPECT_NE(failure, "") << "the process ends with these words";
  expander_.reset();
  start();
  EXPECT_EQ(expander_->inserter().modelled().size(), 1600U) << "the trainer's";
  publish_input(floor_round(-1, 1.5F));
  ASSERT_TRUE(settled_after(1));
  EXPECT_EQ(trainer_->points.size(), 2500U);
  EXPECT_EQ(distinct_points(), 2500U);
}

}  // namespace
}  // namespace splatbus::expander::test

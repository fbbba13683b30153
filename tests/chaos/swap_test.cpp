// Every service of a live pipeline is swapped three times in a row, as an operator does it.
#include <gtest/gtest.h>
#include <signal.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <memory>
#include <tuple>

#include "operated_pipeline.h"

namespace splatbus::chaos {
namespace {

constexpr double kSteady = 0.002;
/// More than training moves this small model by in the meantime. Without the views of the one before, it loses more in
/// the four seconds after a swap.
constexpr double kLoss = 0.005;
constexpr std::size_t kSamples = 8;

class LiveSwap : public OperatedPipeline {
 protected:
  void SetUp() override { start(std::make_unique<PipelineUnderFire>()); }

  void kill(const std::string& name) {
    const pid_t before = pipeline_->pids().at(name);
    ASSERT_EQ(::kill(before, SIGKILL), 0);
    EXPECT_TRUE(pipeline_->wait_until([&] { return pipeline_->pids().at(name) != before; })) << name;
  }

  /// Until so many more samples have come: their least and their mean.
  std::pair<double, double> ssim_of_the_next(std::size_t count) {
    const auto first = static_cast<std::ptrdiff_t>(pipeline_->samples().size());
    EXPECT_TRUE(
        pipeline_->wait_until([&] { return pipeline_->samples().size() >= static_cast<std::size_t>(first) + count; }));
    return ssim_since(first);
  }
  [[nodiscard]] std::pair<double, double> ssim_since(std::ptrdiff_t first) const {
    double least = 1, sum = 0;
    for (auto sample = pipeline_->samples().begin() + first; sample != pipeline_->samples().end(); ++sample) {
      least = std::min(least, sample->ssim);
      sum += sample->ssim;
    }
    const auto count = static_cast<double>(pipeline_->samples().size()) - static_cast<double>(first);
    return {least, sum / count};
  }

  /// Until training changes it no more than it does all the time.
  std::pair<double, double> ssim_until_steady() {
    auto now = ssim_of_the_next(kSamples);
    for (int turn = 0; turn < 10; ++turn) {
      const auto next = ssim_of_the_next(kSamples);
      std::printf("no swap: SSIM %.4f, then %.4f (least %.4f)\n", now.second, next.second, next.first);
      const bool steady = std::abs(next.second - now.second) < kSteady;
      now = next;
      if (steady) break;
    }
    return now;
  }
};

/// With insertion and removal at rest, the same Gaussians, by their ids, after each swap; and the picture stays. So it
/// does when a trainer is killed, and the next one adopts the model, but without moments and ages.
TEST_F(LiveSwap, ATrainerThreeTimesInARowAndKilled) {
  only_train();
  const std::vector<std::uint64_t> before = sorted_ids();
  ASSERT_GT(before.size(), 100U);
  EXPECT_EQ(std::ranges::adjacent_find(before), before.end());
  pipeline_->sample_pictures();
  auto [least_before, mean_before] = ssim_until_steady();
  for (const std::string how : {"swap", "swap", "swap", "kill"}) {
    const auto first = static_cast<std::ptrdiff_t>(pipeline_->samples().size());
    how == "swap" ? swap("trainer") : kill("trainer");
    const auto [least_during, mean_during] = ssim_of_the_next(2).first > 0 ? ssim_since(first) : std::pair(0.0, 0.0);
    const auto [least_after, mean_after] = ssim_of_the_next(kSamples);
    std::printf("%s: SSIM %.4f (least %.4f) before, least %.4f during, %.4f (least %.4f) after\n", how.c_str(),
                mean_before, least_before, least_during, mean_after, least_after);
    EXPECT_GT(least_during, least_before - kLoss) << how << ": the picture stays while they change places";
    EXPECT_GT(mean_after, mean_before - kLoss) << how;
    EXPECT_EQ(sorted_ids(), before) << how << ": none lost, none twice, none new";
    std::tie(least_before, mean_before) = std::pair(least_after, mean_after);
  }
}

TEST_F(LiveSwap, EveryOtherServiceThreeTimesInARow) {
  for (const char* name : {"expander", "relight", "capture-bridge", "streamer", "gateway", "viewer"}) {
    SCOPED_TRACE(name);
    for (int time = 0; time < 3; ++time) ASSERT_NO_FATAL_FAILURE(swap(name));
    ASSERT_TRUE(pipeline_->wait_until_well(kSsim, {})) << pipeline_->log();
  }
}

}  // namespace
}  // namespace splatbus::chaos

// A trainer is swapped to another device and back while it trains: the picture stays, and so do the Gaussians. Without
// a GPU the same is done from one process on the CPU to the next.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <memory>
#include <numeric>
#include <ostream>
#include <span>
#include <utility>

#include "../integration/pipeline.h"
#include "bus/backend.h"
#include "operated_pipeline.h"

namespace splatbus::chaos {
namespace {

constexpr int kViews = 4;  // held out: between the views that are trained on
constexpr std::size_t kSamples = std::size_t{8} * kViews;
constexpr double kSteady = 0.002, kLoss = 0.005, kLossS = 1;

using Samples = std::span<const PipelineUnderFire::Sample>;

/// How far it fell below what it was before, and for how long by more than kLoss, in seconds, as far as samples tell.
struct Drop {
  double depth = 0, time_s = 0;
};

Drop drop_of(Samples samples, double before) {
  Drop drop;
  std::int64_t since_ns = 0;  // of the first that is lower; 0: none is
  for (const auto& sample : samples) {
    const double depth = before - sample.level;
    drop.depth = std::max(drop.depth, depth);
    if (depth <= kLoss) {
      since_ns = 0;
      continue;
    }
    if (since_ns == 0) since_ns = sample.time_ns;
    drop.time_s = std::max(drop.time_s, static_cast<double>(sample.time_ns - since_ns) * 1e-9);
  }
  return drop;
}

struct Way {
  const char* name;
  std::vector<std::string> backends;
};
void PrintTo(const Way& way, std::ostream* out) {
  *out << way.name;
}

class DeviceSwap : public OperatedPipeline, public testing::WithParamInterface<Way> {
 protected:
  void SetUp() override {
    const auto& backends = GetParam().backends;
    const bool has_device = bus::choose_backend("auto") == Device::Cuda;
    if (std::ranges::count(backends, "cuda") > 0 && !has_device) GTEST_SKIP() << "no CUDA device";
    std::string file = cli::Pipeline::launch_file();
    const std::string trainer = "  - name: trainer\n";
    file.insert(file.find(trainer) + trainer.size(), "    backend: " + backends.front() + "\n");
    // With four it learns these by heart, on a GPU within seconds, and what is held out gets worse by itself.
    const std::string cameras = "reference_cameras: 4";
    file.replace(file.find(cameras), cameras.size(), "reference_cameras: 12");
    start(std::make_unique<PipelineUnderFire>(file, kViews));
  }

  [[nodiscard]] Samples samples_since(std::size_t first) const { return Samples(pipeline_->samples()).subspan(first); }
  /// In the mean until so many more have come.
  double ssim_of_the_next(std::size_t count) {
    const std::size_t first = pipeline_->samples().size();
    EXPECT_TRUE(pipeline_->wait_until([&] { return pipeline_->samples().size() >= first + count; }));
    const Samples samples = samples_since(first);
    return std::accumulate(samples.begin(), samples.end(), 0.0,
                           [](double sum, const auto& sample) { return sum + sample.level; }) /
           static_cast<double>(samples.size());
  }
  /// Until training changes it by no more than it does all the time.
  double ssim_at_rest() {
    double now = ssim_of_the_next(kSamples);
    for (int turn = 0; turn < 10; ++turn) {
      const double before = std::exchange(now, ssim_of_the_next(kSamples));
      if (std::abs(now - before) < kSteady) break;
    }
    return now;
  }
};

TEST_P(DeviceSwap, KeepsPictureAndGaussians) {
  ASSERT_NO_FATAL_FAILURE(only_train());
  const std::vector<std::uint64_t> ids = sorted_ids();
  ASSERT_GT(ids.size(), 100U);
  ASSERT_EQ(std::ranges::adjacent_find(ids), ids.end()) << "one is there twice";
  const auto& backends = GetParam().backends;
  EXPECT_EQ(pipeline_->heard("trainer").backend, backends.front());
  pipeline_->sample_pictures();
  double before = ssim_at_rest();
  for (const std::string& backend : std::span(backends).subspan(1)) {
    SCOPED_TRACE("swapped to " + backend);
    const std::size_t first = pipeline_->samples().size();
    ASSERT_NO_FATAL_FAILURE(swap("trainer", {"--backend", backend}));
    EXPECT_EQ(pipeline_->heard("trainer").backend, backend);
    EXPECT_TRUE(pipeline_->wait_until([&] { return pipeline_->heard("trainer").counters.contains("handed_over"); }));
    EXPECT_EQ(pipeline_->heard("trainer").counters.at("handed_over"), static_cast<double>(ids.size()))
        << "each with its moments and age";
    const double after = ssim_of_the_next(kSamples);
    const Drop drop = drop_of(samples_since(first), before);
    std::printf("%s: SSIM %.4f before, %.4f after; at most %.4f lower, %.2f s by more than %g\n", backend.c_str(),
                before, after, drop.depth, drop.time_s, kLoss);
    EXPECT_LE(drop.time_s, kLossS);
    EXPECT_GT(after, before - kLoss);
    EXPECT_EQ(sorted_ids(), ids) << "none lost, none twice, none new";
    before = after;
  }
}

INSTANTIATE_TEST_SUITE_P(Trainer, DeviceSwap,
                         testing::Values(Way{"CpuToCpuAndBack", {"cpu", "cpu", "cpu"}},
                                         Way{"CpuToCudaAndBack", {"cpu", "cuda", "cpu"}}),
                         [](const auto& instance) { return std::string(instance.param.name); });

}  // namespace
}  // namespace splatbus::chaos

// What happens to Gaussians between steps, on either device.
#include "trainer/gaussian_kernels.h"

#include <gtest/gtest.h>

#include <cmath>
#include <glm/gtc/quaternion.hpp>
#include <random>

#include "device_pages.h"
#include "gaussians/light.h"
#include "trainer/size_limit.h"

namespace splatbus::trainer::kernels {
namespace {

TEST(AverageWeight, TakesTheValueAtFirstAndSettles) {
  const float settled = 1.0F - std::pow(0.98F, 8.0F);
  EXPECT_FLOAT_EQ(average_weight(settled, 8, 0), 1.0F);
  EXPECT_FLOAT_EQ(average_weight(settled, 8, 8), 1.0F);
  EXPECT_NEAR(average_weight(settled, 8, 64), 0.5F, 1e-6F);
  EXPECT_FLOAT_EQ(average_weight(settled, 8, 100000), settled);
  float last = 1;
  for (std::uint64_t age = 0; age < 2000; ++age) {
    EXPECT_LE(average_weight(settled, 8, age), last);
    last = average_weight(settled, 8, age);
  }
}

constexpr std::uint32_t kAverage = 41;  // first row

TEST_P(KernelsOn, EveryGaussianIsAveragedOnceInEightSteps) {
  Pages pages = make_pages({{0, 300}, {2 * kPageLanes, kPageLanes}, {5 * kPageLanes, 1}});
  for (std::uint32_t i = 0; i < pages.indices(); ++i) {
    pages.at(0, i) = 1;
    pages.at(20, i) = 2;
    pages.at(40, i) = 4;
  }
  const auto created = pages.place(std::vector<std::uint64_t>(pages.indices()));
  for (std::uint64_t step = 100000; step < 100008; ++step) {
    pages.run([&](auto stream, const auto& g) { update_average(stream, g, created.data(), step, 0.25F); }, 40);
  }
  for (std::uint32_t i = 0; i < pages.indices(); ++i) {
    const bool there = i < 300 || i / kPageLanes == 2 || i == 5 * kPageLanes;
    ASSERT_EQ(pages.at(kAverage, i), there ? 0.25F : 0) << i;
    ASSERT_EQ(pages.at(kAverage + 20, i), there ? 0.5F : 0) << i;
    ASSERT_EQ(pages.at(kAverage + 40, i), 0) << "does not train";
    ASSERT_EQ(pages.at(40, i), 4);
  }
}

TEST_P(KernelsOn, AgeCountsFromWhenTheGaussianWasMade) {
  Pages pages = make_pages({{0, 3}});
  for (std::uint32_t i = 0; i < 3; ++i) pages.at(0, i) = 1;
  const auto created = pages.place(std::vector<std::uint64_t>{991, 873, 0});
  pages.run([&](auto stream, const auto& g) { update_average(stream, g, created.data(), 1001, 0.125F); });
  EXPECT_FLOAT_EQ(pages.at(kAverage, 0), 1.0F) << "10 steps old";
  EXPECT_FLOAT_EQ(pages.at(kAverage, 1), 0.25F) << "8 of a quarter of 128 steps";
  EXPECT_FLOAT_EQ(pages.at(kAverage, 2), 0.125F) << "old";
}

TEST_P(KernelsOn, NoGaussianIsLargerThanItsShareOfTheDistanceToACamera) {
  constexpr int kMean = ParameterLayout::kMean, kScale = ParameterLayout::kLogScale;
  Pages pages = make_pages({{0, 2}, {kPageLanes, 1, 7}, {2 * kPageLanes, 1}, {3 * kPageLanes, 1, kFarFieldFrame}});
  pages.ranges[2].frozen = 1;
  for (std::uint32_t i : {0U, 1U, kPageLanes, 2 * kPageLanes, 3 * kPageLanes}) {
    pages.at(kMean, i) = 2;  // metres from one eye, and 6 from the other
    for (int axis = 0; axis < 3; ++axis) {
      pages.at(kScale + axis, i) = pages.at(kAverage + kScale + axis, i) = std::log(axis == 1 ? 5.0F : 0.1F);
    }
  }
  pages.at(kMean, 1) = 60;
  Eyes eyes{.x_m = {0, 8}, .y_m = {0, 0}, .z_m = {0, 0}, .count = 2};
  pages.run([&](auto stream, const auto& g) { limit_sizes(stream, g, eyes, 0.2F); });
  for (const std::uint32_t live : {0U, kAverage}) {
    EXPECT_FLOAT_EQ(std::exp(pages.at(live + kScale + 1, 0)), 0.4F);
    EXPECT_FLOAT_EQ(std::exp(pages.at(live + kScale, 0)), 0.1F);
    EXPECT_FLOAT_EQ(std::exp(pages.at(live + kScale + 1, 1)), 5) << "far off";
    EXPECT_FLOAT_EQ(std::exp(pages.at(live + kScale + 1, kPageLanes)), 5) << "of an object";
    EXPECT_FLOAT_EQ(std::exp(pages.at(live + kScale + 1, 2 * kPageLanes)), 5) << "frozen";
    EXPECT_FLOAT_EQ(std::exp(pages.at(live + kScale + 1, 3 * kPageLanes)), 0.2F * kFarFieldRadius);
  }
}

TEST_P(KernelsOn, MarksWhatIsTransparentHugeOrNotFinite) {
  Pages pages = make_pages({{0, 20}, {kPageLanes, 10}});
  std::vector<std::uint64_t> created_step(pages.indices(), 0);
  created_step[6] = created_step[7] = 950;
  pages.at(ParameterLayout::kOpacityLogit, 5) = -9;
  pages.at(ParameterLayout::kOpacityLogit, 6) = -9;  // young
  pages.at(33, 7) = NAN;                             // young
  pages.at(ParameterLayout::kLogScale + 2, kPageLanes + 3) = 2;
  pages.at(ParameterLayout::kMean, kPageLanes + 4) = INFINITY;
  pages.at(40, kPageLanes + 5) = NAN;                 // does not train
  pages.at(ParameterLayout::kOpacityLogit, 20) = -9;  // nobody
  const auto created = pages.place(created_step);
  auto dead = pages.place(std::vector<std::uint8_t>(pages.indices(), 3));
  auto counts = pages.place(std::vector<PruneCounts>(1));
  pages.run(
      [&](auto stream, const auto& g) {
        mark_prunable(stream, g, {}, created.data(),
                      {.step = 1000, .min_age_steps = 51, .min_opacity_logit = -5, .max_log_scale = 1}, dead.data(),
                      counts.data());
      },
      40);
  const std::vector<std::uint8_t> marks = dead.to_host();
  for (std::uint32_t i = 0; i < pages.indices(); ++i) {
    const bool gone = i == 5 || i == 7 || i == kPageLanes + 3 || i == kPageLanes + 4;
    const bool there = i < 20 || (i >= kPageLanes && i < kPageLanes + 10);
    ASSERT_EQ(marks[i], there ? (gone ? 1 : 0) : 3) << i;
  }
  EXPECT_EQ(counts.to_host()[0].removed, 4U);
  EXPECT_EQ(counts.to_host()[0].not_finite, 2U);
}

TEST_P(KernelsOn, TooLargeIsWhatIsTooLargeInMetres) {
  Pages pages = make_pages({{0, 20}, {kPageLanes, 10, 3}, {2 * kPageLanes, 10, 5}, {3 * kPageLanes, 10, 9}});
  for (std::uint32_t page = 0; page < 4; ++page) pages.at(ParameterLayout::kLogScale, page * kPageLanes) = 0.5F;
  const std::vector<FrameScale> of{{3, 1}, {9, -1}};
  const auto scales = pages.place(of);
  const auto created = pages.place(std::vector<std::uint64_t>(pages.indices(), 0));
  auto dead = pages.place(std::vector<std::uint8_t>(pages.indices(), 0));
  auto counts = pages.place(std::vector<PruneCounts>(1));
  const auto pruned = [&](float max_log_scale) {
    pages.run([&](auto stream, const auto& g) {
      mark_prunable(stream, g, {scales.data(), 2}, created.data(),
                    {.step = 1000, .min_age_steps = 51, .min_opacity_logit = -5, .max_log_scale = max_log_scale},
                    dead.data(), counts.data());
    });
    const auto marks = dead.to_host();
    return std::vector<int>{marks[0], marks[kPageLanes], marks[2 * kPageLanes], marks[3 * kPageLanes]};
  };
  EXPECT_EQ(pruned(0), (std::vector{1, 1, 1, 0}));
  EXPECT_EQ(pruned(1), (std::vector{0, 1, 0, 0}));
}

TEST_P(KernelsOn, FrozenPagesAreLeftAlone) {
  Pages pages = make_pages({{0, 20}, {kPageLanes, 10, kWorldFrame, 1}});
  for (const std::uint32_t i : {4U, kPageLanes + 4}) {
    pages.at(0, i) = 1;
    pages.at(ParameterLayout::kOpacityLogit, i) = -9;
  }
  const auto created = pages.place(std::vector<std::uint64_t>(pages.indices(), 0));
  auto dead = pages.place(std::vector<std::uint8_t>(pages.indices(), 3));
  auto counts = pages.place(std::vector<PruneCounts>(1));
  const auto seen = pages.place(std::vector<std::uint32_t>(pages.indices(), 1));
  const auto norm = pages.place(std::vector<float>(pages.indices(), 1));
  device::Buffer<std::uint32_t> chosen(dead.stream(), 2 * kPageLanes);
  std::uint32_t dense = 0;
  pages.run([&](auto stream, const auto& g) {
    mark_prunable(stream, g, {}, created.data(),
                  {.step = 1000, .min_age_steps = 51, .min_opacity_logit = -5, .max_log_scale = 1}, dead.data(),
                  counts.data());
    for (std::uint64_t step = 1001; step < 1001 + kStripes; ++step) {
      update_average(stream, g, created.data(), step, 0.5F);
    }
    dense = list_dense(stream, g, {.mean2d_norm = norm.data(), .steps = seen.data()}, 0.5F, chosen.data());
  });
  const auto marks = dead.to_host();
  EXPECT_EQ(marks[4], 1);
  EXPECT_EQ(marks[kPageLanes + 4], 0);
  EXPECT_FLOAT_EQ(pages.at(kAverage, 4), 0.5F);
  EXPECT_EQ(pages.at(kAverage, kPageLanes + 4), 0);
  EXPECT_EQ(dense, 20U);
}

TEST_P(KernelsOn, MovementIsHowFarPagesAreFromTheirAverages) {
  Pages pages = make_pages({{0, 2}, {kPageLanes, 3}, {2 * kPageLanes, 1, kWorldFrame, 1}});
  constexpr int kScale = ParameterLayout::kLogScale, kOpacity = ParameterLayout::kOpacityLogit;
  const auto average = [&](int channel, std::uint32_t i) -> float& {
    return pages.at(kAverage + static_cast<std::uint32_t>(channel), i);
  };
  // The first page: one that is opaque and a tenth of its 0.5 m away, one that nobody sees and far away.
  for (int axis = 0; axis < 3; ++axis) {
    pages.at(static_cast<std::uint32_t>(kScale + axis), 0) = average(kScale + axis, 0) =
        std::log(axis == 1 ? 0.5F : 0.1F);
  }
  average(0, 0) = 1;
  pages.at(0, 0) = 1.03F;
  pages.at(2, 0) = 0.04F;
  average(kOpacity, 0) = 30;
  pages.at(0, 1) = 9;
  average(kOpacity, 1) = -30;
  // The second: of three alike one is 0.3 larger and one 0.6 redder.
  pages.at(kScale, kPageLanes) = 0.3F;
  pages.at(ParameterLayout::kAlbedo, kPageLanes + 1) = 0.6F;
  pages.at(0, 2 * kPageLanes) = 5;
  std::vector<float> movements;
  pages.run([&](auto stream, const auto& g) { movements = page_movements(stream, g, Appearance::Transfer); });
  ASSERT_EQ(movements.size(), 3U);
  EXPECT_NEAR(movements[0], 0.1F, 1e-5F);
  EXPECT_NEAR(movements[1], 0.3F, 1e-5F);
  EXPECT_EQ(movements[2], 0) << "frozen";
}

TEST_P(KernelsOn, ListsThoseWhoseMeanGradientIsLarge) {
  Pages pages = make_pages({{0, 700}, {3 * kPageLanes, 900}});
  std::mt19937 random(4);
  std::vector<float> sum(pages.indices());
  std::vector<std::uint32_t> steps(pages.indices()), expected;
  for (std::uint32_t i = 0; i < pages.indices(); ++i) {
    steps[i] = random() % 4;
    sum[i] = static_cast<float>(random() % 100) / 50;
    const bool there = i < 700 || (i >= 3 * kPageLanes && i < 3 * kPageLanes + 900);
    if (there && steps[i] > 0 && sum[i] / static_cast<float>(steps[i]) >= 0.5F) expected.push_back(i);
  }
  const auto norm = pages.place(sum);
  const auto seen = pages.place(steps);
  device::Buffer<std::uint32_t> listed = pages.place(std::vector<std::uint32_t>(2 * kPageLanes));
  std::uint32_t count = 0;
  pages.run([&](auto stream, const auto& g) {
    count = list_dense(stream, g, {.mean2d_norm = norm.data(), .steps = seen.data()}, 0.5F, listed.data());
  });
  std::vector<std::uint32_t> indices = listed.to_host();
  indices.resize(count);
  EXPECT_EQ(indices, expected);
}

TEST_P(KernelsOn, ChildrenOfASplitAreDrawnFromIt) {
  constexpr std::uint32_t kCount = 3 * kPageLanes;  // and as many copies behind them
  std::vector<IndexRange> ranges;
  for (std::uint32_t page = 0; page < 6; ++page) ranges.push_back({page * kPageLanes, kPageLanes});
  Pages pages = make_pages(ranges);
  std::vector<std::uint32_t> copy_of(pages.indices(), 0), copies(kCount);
  const glm::quat rotation = glm::normalize(glm::quat(0.7F, 0.3F, -0.4F, 0.1F));
  for (std::uint32_t i = 0; i < 2 * kCount; ++i) {
    for (std::uint32_t axis = 0; axis < 3; ++axis) {
      const float size = (i % 2 == 0 ? 0.2F : 0.05F) / static_cast<float>(axis + 1);  // every other one is split
      pages.at(ParameterLayout::kLogScale + axis, i) = std::log(size);
    }
    const float scaled[4] = {3 * rotation.w, 3 * rotation.x, 3 * rotation.y, 3 * rotation.z};
    for (std::uint32_t c = 0; c < 4; ++c) pages.at(ParameterLayout::kRotation + c, i) = scaled[c];
  }
  for (std::uint32_t k = 0; k < kCount; ++k) {
    copy_of[k] = k + 1;
    copies[k] = kCount + k;
  }
  copies[10] = model::kNotInserted;
  const auto of = pages.place(copy_of);
  const auto to = pages.place(copies);
  pages.run([&](auto stream, const auto& g) {
    split(stream, g, {}, of.data(), to.data(), {.max_clone_log_scale = std::log(0.1F), .seed = 5});
    stream.wait();
  });
  double sum[3] = {}, squares[3] = {}, products[3] = {};  // products: of the two children of one
  std::size_t children = 0;
  for (std::uint32_t k = 0; k < kCount; ++k) {
    const bool splits = k % 2 == 0 && k != 10;
    float first[3] = {};
    for (const std::uint32_t child : {k, kCount + k}) {
      const glm::vec3 moved(pages.at(0, child), pages.at(1, child), pages.at(2, child));
      if (!splits) {
        ASSERT_EQ(moved, glm::vec3(0)) << k;
        continue;
      }
      const glm::vec3 local = glm::inverse(rotation) * moved;
      for (int axis = 0; axis < 3; ++axis) {
        const float size = 0.2F / static_cast<float>(axis + 1), sigmas = local[axis] / size;
        ASSERT_LT(std::abs(sigmas), 6.0F);
        ASSERT_NEAR(pages.at(ParameterLayout::kLogScale + static_cast<std::uint32_t>(axis), child),
                    std::log(size / 1.6F), 1e-5F);
        sum[axis] += sigmas;
        squares[axis] += sigmas * sigmas;
        if (child == k) first[axis] = sigmas;
        if (child != k) products[axis] += first[axis] * sigmas;
      }
      ++children;
    }
  }
  // Of standard normal draws, to five standard errors.
  const auto n = static_cast<double>(children);
  ASSERT_GT(children, kCount / 2);
  for (int axis = 0; axis < 3; ++axis) {
    EXPECT_NEAR(sum[axis] / n, 0.0, 5 / std::sqrt(n)) << axis;
    EXPECT_NEAR(squares[axis] / n, 1.0, 5 * std::sqrt(2 / n)) << axis;
    EXPECT_NEAR(2 * products[axis] / n, 0.0, 5 / std::sqrt(n / 2)) << axis;
  }
}

INSTANTIATE_TEST_SUITE_P(Devices, KernelsOn, testing::Values(Device::Cpu, Device::Cuda),
                         [](const auto& device) { return std::string(name_of(device.param)); });

}  // namespace
}  // namespace splatbus::trainer::kernels

#include "trainer/average.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

namespace splatbus::trainer {
namespace {

/// One slot's memory in a vector, for columns without a slab.
struct Columns {
  explicit Columns(std::size_t capacity)
      : memory(SlabLayout(ParameterLayout{}, capacity).bytes), planes(ParameterLayout{}, capacity, memory.data()) {}
  std::vector<std::byte> memory;
  ModelPlanes planes;
};

TEST(EmaWeight, TakesTheValueAtFirstAndSettlesAtTheDecay) {
  EXPECT_FLOAT_EQ(ema_weight(0.98F, 8, 0), 1.0F);
  EXPECT_FLOAT_EQ(ema_weight(0.98F, 8, 8), 1.0F);
  EXPECT_NEAR(ema_weight(0.98F, 8, 64), 0.5F, 1e-6F);
  EXPECT_NEAR(ema_weight(0.98F, 8, 100000), 1.0F - std::pow(0.98F, 8.0F), 1e-6F);
  EXPECT_FLOAT_EQ(ema_weight(0.0F, 8, 100000), 1.0F);
}

TEST(EmaWeight, NeverGrowsWithAge) {
  float last = 1.0F;
  for (std::uint64_t age = 0; age < 2000; ++age) {
    const float share = ema_weight(0.98F, 8, age);
    EXPECT_LE(share, last);
    last = share;
  }
}

TEST(TimeAverage, ReachesEveryColumnOnceInEightSteps) {
  Columns columns(32);
  const std::vector<std::uint64_t> birth(21, 0);
  for (std::size_t i = 0; i < 21; ++i) columns.planes.parameters[i] = 1.0F;
  TimeAverage average;
  for (std::uint64_t step = 1; step <= 8; ++step) average.update(columns.planes, 21, 41, birth, step, 0.98F);
  for (std::size_t i = 0; i < 21; ++i) EXPECT_FLOAT_EQ(columns.planes.average[i], 1.0F) << i;
  EXPECT_FLOAT_EQ(columns.planes.average[21], 0.0F) << "beyond the count";
}

TEST(TimeAverage, CountsAgeFromWhenTheGaussianWasMade) {
  Columns columns(32);
  std::vector<std::uint64_t> made_at(24, 0);
  made_at[0] = 990;
  made_at[1] = 872;
  for (std::size_t i = 0; i < 24; ++i) columns.planes.parameters[i] = 1.0F;
  TimeAverage().update(columns.planes, 24, 41, made_at, 1000, 0.98F);  // the first three columns' turn
  EXPECT_FLOAT_EQ(columns.planes.average[0], 1.0F) << "10 steps old";
  EXPECT_FLOAT_EQ(columns.planes.average[1], 0.25F) << "8 of a quarter of 128 steps";
  EXPECT_NEAR(columns.planes.average[2], 1.0F - std::pow(0.98F, 8.0F), 1e-6F) << "old";
  EXPECT_EQ(columns.planes.average[3], 0.0F) << "its turn comes later";
}

TEST(TimeAverage, SmoothsJitterOfAnOldGaussian) {
  Columns columns(16);
  const std::vector<std::uint64_t> birth(1, 0);
  TimeAverage average;
  for (std::uint64_t step = 1; step <= 4000; ++step) {
    columns.planes.parameters[0] = 3.0F + ((step / 8) % 2 == 0 ? 1.0F : -1.0F);
    average.update(columns.planes, 1, 41, birth, step, 0.98F);
  }
  EXPECT_NEAR(columns.planes.average[0], 3.0F, 0.1F);
}

TEST(TimeAverage, LeavesInactiveChannelsAlone) {
  Columns columns(16);
  const std::vector<std::uint64_t> birth(8, 0);
  for (std::size_t i = 0; i < 8; ++i) {
    columns.planes.parameters[i] = 1.0F;
    columns.planes.parameters[std::size_t{14} * 16 + i] = 1.0F;
  }
  TimeAverage average;
  for (std::uint64_t step = 1; step <= 8; ++step) average.update(columns.planes, 8, 14, birth, step, 0.98F);
  EXPECT_FLOAT_EQ(columns.planes.average[3], 1.0F);
  EXPECT_FLOAT_EQ(columns.planes.average[14 * 16 + 3], 0.0F);
}

}  // namespace
}  // namespace splatbus::trainer

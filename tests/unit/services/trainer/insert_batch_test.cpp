#include "trainer/insert_batch.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <limits>

#include "sample_batch.h"
#include "trainer/commands.h"

namespace splatbus::trainer {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kInfinity = std::numeric_limits<float>::infinity();

TEST(InsertRows, KeepsWhatIsSound) {
  InsertBatch batch = sample_batch(1, 1, 10);
  const InsertBatch before = batch;
  keep_valid_rows(batch);
  EXPECT_EQ(batch.count, 10U);
  EXPECT_EQ(batch.dropped, 0U);
  EXPECT_EQ(batch.mean, before.mean);
  EXPECT_EQ(batch.cell, before.cell);
}

TEST(InsertRows, DropsTheRowThatIsNotAGaussianAndNoOther) {
  const std::vector<std::function<void(InsertBatch&)>> damages = {
      [](InsertBatch& b) { b.mean[3] = kNan; },
      [](InsertBatch& b) { b.mean[10 + 3] = kInfinity; },
      [](InsertBatch& b) { b.mean[3] = 1e9F; },
      [](InsertBatch& b) { b.log_scale[20 + 3] = kNan; },
      [](InsertBatch& b) { b.rotation[3] = kNan; },
      [](InsertBatch& b) {
        for (std::size_t c = 0; c < 4; ++c) b.rotation[c * 10 + 3] = 0;
      },
      [](InsertBatch& b) { b.opacity_logit[3] = -kInfinity; },
      [](InsertBatch& b) { b.albedo[3] = kNan; },
      [](InsertBatch& b) { b.visibility[3] = kNan; },
      [](InsertBatch& b) { b.normal[3] = kNan; },
      [](InsertBatch& b) {
        for (std::size_t c = 0; c < 3; ++c) b.normal[c * 10 + 3] = 0;
      },
  };
  for (std::size_t d = 0; d < damages.size(); ++d) {
    InsertBatch batch = sample_batch(1, 1, 10);
    const InsertBatch before = batch;
    damages[d](batch);
    keep_valid_rows(batch);
    ASSERT_EQ(batch.count, 9U) << "damage " << d;
    EXPECT_EQ(batch.dropped, 1U) << "damage " << d;
    ASSERT_EQ(batch.mean.size(), 27U);
    EXPECT_EQ(batch.mean[2], before.mean[2]);
    EXPECT_EQ(batch.mean[9 + 3], before.mean[10 + 4]) << "rows after it move up, in every plane";
    EXPECT_EQ(batch.cell[3], before.cell[4]);
    EXPECT_EQ(batch.object_id.size(), 9U);
  }
}

TEST(InsertRows, NormalisesAndClampsTheRest) {
  InsertBatch batch = sample_batch(1, 1, 4);
  for (std::size_t c = 0; c < 4; ++c) batch.rotation[c * 4 + 1] *= 3.0F;
  batch.albedo[2] = 1.5F;
  batch.visibility[2] = -0.25F;
  batch.opacity_logit[2] = 100.0F;
  keep_valid_rows(batch);
  float square = 0;
  for (std::size_t c = 0; c < 4; ++c) square += batch.rotation[c * 4 + 1] * batch.rotation[c * 4 + 1];
  EXPECT_NEAR(square, 1.0F, 1e-5F);
  EXPECT_FLOAT_EQ(batch.albedo[2], 1.0F);
  EXPECT_FLOAT_EQ(batch.visibility[2], 0.0F);
  EXPECT_LT(batch.opacity_logit[2], 20.0F);
}

TEST(Commands, HoldNoMoreRowsThanTheirBound) {
  InsertBatch large;
  large.count = Commands::kMaxRows - 10;
  Commands commands;
  EXPECT_TRUE(commands.add(InsertBatch(large)));
  EXPECT_TRUE(commands.add(sample_batch(1, 1, 10)));
  EXPECT_FALSE(commands.add(sample_batch(1, 2, 1)));
  EXPECT_TRUE(commands.add(sample_batch(1, 1, 10))) << "it waits already";
  EXPECT_EQ(commands.inserts.size(), 2U);
}

TEST(Commands, HoldNoMoreBatchesThanTheirBound) {
  Commands commands;
  for (std::uint64_t batch = 0; batch < Commands::kMaxInserts; ++batch) {
    ASSERT_TRUE(commands.add(sample_batch(1, batch, 0)));
  }
  EXPECT_FALSE(commands.add(sample_batch(1, Commands::kMaxInserts, 0)));
}

}  // namespace
}  // namespace splatbus::trainer

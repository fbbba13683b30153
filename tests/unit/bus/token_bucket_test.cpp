#include "bus/token_bucket.h"

#include <gtest/gtest.h>

#include <limits>
#include <stdexcept>

#include "../nanoseconds.h"

namespace splatbus::bus {
namespace {

TEST(TokenBucket, BeginsFullAndRefusesWhatIsNotThere) {
  TokenBucket bucket(10, 3);
  EXPECT_TRUE(bucket.take(1, 5 * kSecond));
  EXPECT_TRUE(bucket.take(2, 5 * kSecond));
  EXPECT_FALSE(bucket.take(1, 5 * kSecond));
  EXPECT_FALSE(bucket.take(0.5, 5 * kSecond));
}

TEST(TokenBucket, ARefusalCostsNothing) {
  TokenBucket bucket(1, 4);
  EXPECT_FALSE(bucket.take(5, 0));
  EXPECT_TRUE(bucket.take(4, 0));
}

TEST(TokenBucket, FillsAtItsRateUpToItsBurst) {
  TokenBucket bucket(10, 3);
  ASSERT_TRUE(bucket.take(3, 0));
  EXPECT_FALSE(bucket.take(1, kSecond / 10 - 1));
  EXPECT_TRUE(bucket.take(1, kSecond / 10 + 1));
  EXPECT_DOUBLE_EQ(bucket.available(1000 * kSecond), 3);
}

TEST(TokenBucket, OverAnyTimeNoMoreThanTheBurstAndTheRate) {
  TokenBucket bucket(100, 20);
  int taken = 0;
  for (std::int64_t now = 0; now <= 2 * kSecond; now += kSecond / 5000) taken += bucket.take(1, now) ? 1 : 0;
  EXPECT_GE(taken, 219);
  EXPECT_LE(taken, 220);
}

TEST(TokenBucket, AClockThatGoesBackBringsNothing) {
  TokenBucket bucket(10, 2);
  ASSERT_TRUE(bucket.take(2, 10 * kSecond));
  EXPECT_FALSE(bucket.take(1, 9 * kSecond));
  EXPECT_FALSE(bucket.take(1, 10 * kSecond));
  EXPECT_TRUE(bucket.take(1, 10 * kSecond + kSecond / 5));
}

TEST(TokenBucket, ANewRateCountsFromNow) {
  TokenBucket bucket(1, 10);
  ASSERT_TRUE(bucket.take(10, 0));
  bucket.set(100, 5, kSecond);  // one token has come at the old rate
  EXPECT_DOUBLE_EQ(bucket.available(kSecond), 1);
  EXPECT_DOUBLE_EQ(bucket.available(kSecond + kSecond / 50), 3);
  EXPECT_DOUBLE_EQ(bucket.available(9 * kSecond), 5);
}

TEST(TokenBucket, RefusesNonsense) {
  EXPECT_THROW(TokenBucket(-1, 1), std::invalid_argument);
  EXPECT_THROW(TokenBucket(1, 0), std::invalid_argument);
  EXPECT_THROW(TokenBucket(std::numeric_limits<double>::quiet_NaN(), 1), std::invalid_argument);
  TokenBucket bucket(1, 1);
  EXPECT_FALSE(bucket.take(-1, 0));
  EXPECT_FALSE(bucket.take(std::numeric_limits<double>::quiet_NaN(), 0));
}

}  // namespace
}  // namespace splatbus::bus

// Which rounds wait, are tried again and are lost.
#include "expander/waiting_rounds.h"

#include <gtest/gtest.h>

#include <stdexcept>
#include <vector>

namespace splatbus::expander {
namespace {

constexpr std::int64_t kRetry_ns = 100;

class TakenRound final : public Round {
 public:
  explicit TakenRound(RoundInfo info) : info_(std::move(info)) {}
  [[nodiscard]] const RoundInfo& info() const override { return info_; }
  [[nodiscard]] std::size_t size() const override { return 0; }
  [[nodiscard]] std::size_t dropped() const override { return 0; }

 private:
  RoundInfo info_;
};

IncomingRound incoming(std::uint64_t rig_generation) {
  const bus::TensorView none("none", {0}, bus::ElementType::F32, nullptr, 0, nullptr);
  IncomingRound round{{}, 0, none, none, none, none, none, none, none, none, none};
  round.rig_generation = rig_generation;
  return round;
}

/// Says what is done to which rig generation; fails while `broken`.
class WaitingRoundsTest : public testing::Test {
 protected:
  WaitingRoundsTest() {
    work_.take = [this](const IncomingRound& round) {
      taken_.push_back(round.rig_generation);
      if (broken_take_) throw std::runtime_error("no memory");
      return gone_ ? nullptr : std::make_unique<TakenRound>(round);
    };
    work_.grow = [this](const Round& round) {
      if (broken_grow_ == round.info().rig_generation) throw std::runtime_error("no memory");
      grown_.push_back(round.info().rig_generation);
    };
    work_.failed = [this](const RoundInfo& info, const std::exception&, bool again) {
      failed_.push_back(info.rig_generation);
      again_ = again;
    };
  }

  using Generations = std::vector<std::uint64_t>;
  WaitingRounds rounds_;
  WaitingRounds::Work work_;
  Generations taken_, grown_, failed_;
  bool broken_take_ = false, gone_ = false, again_ = false;
  std::uint64_t broken_grow_ = 0;
};

TEST_F(WaitingRoundsTest, AreTakenAtOnceAndGrownWhenTheyMay) {
  const auto grow = std::exchange(work_.grow, nullptr);
  EXPECT_TRUE(rounds_.add(incoming(1), 10));
  EXPECT_EQ(rounds_.run(work_, 10, kRetry_ns), 0U);
  EXPECT_TRUE(rounds_.add(incoming(2), 20));
  EXPECT_EQ(rounds_.run(work_, 20, kRetry_ns), 0U);
  EXPECT_EQ(taken_, (Generations{1, 2}));
  EXPECT_EQ(rounds_.since_ns(), 10);
  work_.grow = grow;
  EXPECT_EQ(rounds_.run(work_, 30, kRetry_ns), 0U);
  EXPECT_EQ(grown_, (Generations{1, 2}));
  EXPECT_EQ(taken_.size(), 2U);
  EXPECT_TRUE(rounds_.empty());
}

TEST_F(WaitingRoundsTest, OneThatFailsHoldsUpNoOther) {
  broken_grow_ = 1;
  rounds_.add(incoming(1), 0);
  rounds_.add(incoming(2), 0);
  EXPECT_EQ(rounds_.run(work_, 0, kRetry_ns), 0U);
  EXPECT_EQ(failed_, Generations{1});
  EXPECT_TRUE(again_);
  EXPECT_EQ(grown_, Generations{2});
  broken_grow_ = 0;
  EXPECT_EQ(rounds_.run(work_, kRetry_ns - 1, kRetry_ns), 0U);
  EXPECT_EQ(grown_, Generations{2}) << "not yet";
  EXPECT_EQ(rounds_.run(work_, kRetry_ns, kRetry_ns), 0U);
  EXPECT_EQ(grown_, (Generations{2, 1}));
  EXPECT_EQ(taken_, (Generations{1, 2})) << "once each";
}

TEST_F(WaitingRoundsTest, OneThatGoesOnFailingIsSetAside) {
  broken_take_ = true;
  rounds_.add(incoming(1), 0);
  for (int i = 1; i < WaitingRounds::kMostTries; ++i) {
    EXPECT_EQ(rounds_.run(work_, i * kRetry_ns, kRetry_ns), 0U);
    EXPECT_TRUE(again_);
  }
  EXPECT_EQ(rounds_.run(work_, 100 * kRetry_ns, kRetry_ns), 1U);
  EXPECT_FALSE(again_);
  EXPECT_TRUE(rounds_.empty());
  EXPECT_EQ(failed_.size(), std::size_t{WaitingRounds::kMostTries});
}

TEST_F(WaitingRoundsTest, WhatIsGoneOrOneTooManyIsLost) {
  gone_ = true;
  rounds_.add(incoming(1), 0);
  EXPECT_EQ(rounds_.run(work_, 0, kRetry_ns), 1U);
  EXPECT_TRUE(failed_.empty());
  gone_ = false;
  for (std::uint64_t i = 0; i < WaitingRounds::kMost; ++i) EXPECT_TRUE(rounds_.add(incoming(10 + i), 0));
  EXPECT_FALSE(rounds_.add(incoming(99), 0));
  EXPECT_EQ(rounds_.run(work_, 0, kRetry_ns), 0U);
  ASSERT_EQ(grown_.size(), WaitingRounds::kMost);
  EXPECT_EQ(grown_.front(), 11U) << "the oldest went";
  EXPECT_EQ(grown_.back(), 99U);
}

}  // namespace
}  // namespace splatbus::expander

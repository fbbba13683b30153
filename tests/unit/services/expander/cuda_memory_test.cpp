// The service on a device that has too little memory for it.
#include "expander/waiting_rounds.h"
#include "expander_fixture.h"

namespace splatbus::expander::test {
namespace {

class ExpanderShortOfMemory : public ExpanderTest {
 protected:
  void SetUp() override {
    ExpanderTest::SetUp();
    if (IsSkipped()) return;
    start();
    publish_input(floor_round(-1, 1));
    ASSERT_TRUE(settled_after(1));
    set("device_mb", "1");  // less than it holds by now
    publish_input(floor_round(-1, 1.5F));
  }

  void expect_nothing_lost() {
    EXPECT_EQ(expander_->mapper().modelled_points(), 1600U);
    EXPECT_EQ(expander_->ledger().gaussians(), 1600U);
    EXPECT_EQ(trainer_->points.size(), 1600U);
  }
};

TEST_P(ExpanderShortOfMemory, TriesARoundAgain) {
  set("retry_s", "0.2");
  ASSERT_TRUE(until([&] { return expander_->counters().failures == 1; }));
  expect_nothing_lost();
  set("device_mb", "0");
  ASSERT_TRUE(settled_after(2));
  EXPECT_EQ(trainer_->points.size(), 2500U);
  EXPECT_EQ(distinct_points(), 2500U);
  EXPECT_EQ(expander_->counters().rounds_lost, 0U);
}

TEST_P(ExpanderShortOfMemory, SetsARoundAsideInTheEnd) {
  set("retry_s", "0.001");
  ASSERT_TRUE(until([&] { return expander_->counters().rounds_lost == 1; }));
  EXPECT_EQ(expander_->counters().failures, static_cast<std::uint64_t>(WaitingRounds::kMostTries));
  expect_nothing_lost();
  set("device_mb", "0");
  publish_input(floor_round(-1, 1.5F));
  ASSERT_TRUE(settled_after(2));
  EXPECT_EQ(distinct_points(), 2500U);
}

INSTANTIATE_TEST_SUITE_P(Machines, ExpanderShortOfMemory,
                         testing::Values(Machine{Device::Cuda, Device::Cuda}), machine_name);

}  // namespace
}  // namespace splatbus::expander::test

// What connections may say, each and together.
#include "gateway/inbound.h"

#include <gtest/gtest.h>

#include <vector>

namespace splatbus::gateway {
namespace {

constexpr std::int64_t kSecondNs = 1'000'000'000, kStepNs = kSecondNs / 100;

Limits limits() {
  Limits limits;
  limits.rate_kbps = 800;  // 100 kB/s
  limits.messages_per_s = 100;
  limits.total_rate_kbps = 4000;  // 500 kB/s
  limits.total_messages_per_s = 500;
  return limits;
}

TEST(Inbound, OneConnectionHasItsOwnAllowance) {
  const Limits bounds = limits();
  InboundTotal total(bounds);
  Inbound one(bounds, total);
  int messages = 0;
  for (std::int64_t now_ns = kSecondNs; now_ns < 11 * kSecondNs; now_ns += kStepNs) {
    while (one.take(10, now_ns)) ++messages;
  }
  EXPECT_LE(messages, 1201);
  EXPECT_GE(messages, 1000);
}

// Twenty that say all that they may, four times what all have together, and one that says something now and then.
TEST(Inbound, AllTogetherHaveTheirBoundAndTheBusiestWaitFirst) {
  for (const std::size_t bytes : {std::size_t{10}, std::size_t{5000}}) {
    const Limits bounds = limits();
    InboundTotal total(bounds);
    std::vector<Inbound> busy(20, Inbound(bounds, total));
    Inbound quiet(bounds, total);
    std::size_t messages = 0;
    std::vector<std::size_t> of_each(busy.size());
    for (int step = 0; step < 2000; ++step) {
      const std::int64_t now_ns = kSecondNs + step * kStepNs;
      for (std::size_t k = 0; k < busy.size(); ++k) {
        // Each is first by turns, as when sockets become readable.
        const std::size_t turn = (k + static_cast<std::size_t>(step)) % busy.size();
        while (busy[turn].take(bytes, now_ns)) ++messages, ++of_each[turn];
      }
      if (step % 50 == 49) {  // all have had what there was at first
        ASSERT_TRUE(quiet.take(bytes, now_ns)) << step;
        ++messages;
      }
    }
    EXPECT_LE(static_cast<double>(messages), 21 * 500) << "of all in 20 s, and what is there at first";
    EXPECT_LE(static_cast<double>(messages * bytes), 21 * 500'000.0);
    for (const std::size_t its : of_each) EXPECT_GT(its, messages / 100) << "nobody is shut out";
  }
}

TEST(Inbound, WhatIsLargerThanAllowedInASecondGoesWhenAllOfThatIsThere) {
  Limits bounds = limits();
  bounds.rate_kbps = bounds.total_rate_kbps = 8;  // 1 kB/s
  InboundTotal total(bounds);
  Inbound one(bounds, total);
  EXPECT_TRUE(one.take(60'000, kSecondNs));
  EXPECT_FALSE(one.take(60'000, kSecondNs + kSecondNs / 2));
  EXPECT_TRUE(one.take(60'000, 2 * kSecondNs + kStepNs));
}

}  // namespace
}  // namespace splatbus::gateway

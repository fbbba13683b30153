// What one viewer is sent, and when.
#include <gtest/gtest.h>

#include <deque>

#include "../../nanoseconds.h"
#include "../../stream/expectations.h"
#include "../../stream/toy_server.h"
#include "streamer/viewer_feed.h"

namespace splatbus::streamer {
namespace {

constexpr std::int64_t kStep = kSecond / 100;

/// A link of so many bytes a second that is filled as the rate allows; the viewer says four times a second what came.
class Link {
 public:
  explicit Link(double most_kbps = 0) { rate.set(0, most_kbps, now_ns_); }

  /// A quarter of a second.
  void pass(double bytes_per_s) {
    for (int k = 0; k < 25; ++k) {
      now_ns_ += kStep;
      while (rate.available(now_ns_) >= kPacket && rate.has_room(kPacket, now_ns_)) {
        rate.take(++sent_, kPacket, now_ns_);
        queued += kPacket;
      }
      const double bytes = std::min(queued, bytes_per_s / 100);
      queued -= bytes;
      arrived += bytes;
      passed_ += bytes;
    }
    rate.acknowledged(static_cast<std::uint64_t>(passed_ / kPacket), now_ns_);
  }

  ViewerRate rate;
  double queued = 0, arrived = 0;

 private:
  static constexpr double kPacket = 1000;
  std::int64_t now_ns_ = kSecond;
  std::uint64_t sent_ = 0;
  double passed_ = 0;
};

TEST(ViewerRate, FindsOutWhatALinkTakesAndFollowsIt) {
  Link link;
  // Bytes a second: less than it begins with, much less, more than ever before.
  for (const double takes : {400'000.0, 90'000.0, 3'000'000.0}) {
    for (int k = 0; k < 100; ++k) link.pass(takes);
    link.arrived = 0;
    for (int k = 0; k < 200; ++k) {
      link.pass(takes);
      ASSERT_LT(link.queued, 1.5 * takes) << takes << ", " << k;
    }
    EXPECT_GT(link.arrived, 0.75 * 50 * takes) << takes;
  }
}

/// A link that takes all, a way behind it, and 8 Mbit/s that are allowed.
class LongWay {
 public:
  LongWay() { rate.set(8000, 0, now_ns_); }

  /// Its sender has a turn every `turn_ns`. Returns kB/s that came.
  double live(double seconds, std::int64_t round_trip_ns, std::int64_t turn_ns = kStep) {
    const std::uint64_t before = come_;
    for (const std::int64_t end = now_ns_ + static_cast<std::int64_t>(seconds * 1e9); now_ns_ < end;
         now_ns_ += turn_ns) {
      for (; !way_.empty() && way_.front().first <= now_ns_; way_.pop_front()) come_ = way_.front().second;
      if (now_ns_ - said_ns_ >= kSecond / 20) rate.acknowledged(come_, said_ns_ = now_ns_);
      while (rate.available(now_ns_) >= 1000 && rate.has_room(1000, now_ns_)) {
        rate.take(++sent_, 1000, now_ns_);
        way_.emplace_back(now_ns_ + round_trip_ns, sent_);
      }
    }
    return static_cast<double>(come_ - before) / seconds;
  }

  ViewerRate rate;

 private:
  std::deque<std::pair<std::int64_t, std::uint64_t>> way_;  // when packets come, and their numbers
  std::int64_t now_ns_ = kSecond, said_ns_ = 0;
  std::uint64_t sent_ = 0, come_ = 0;
};

TEST(ViewerRate, AWayThatBecomesLongerIsNotTakenForAQueueForEver) {
  LongWay link;
  EXPECT_GT(link.live(10, 20'000'000), 900);
  link.live(30, 400'000'000);
  EXPECT_GT(link.live(10, 400'000'000), 800);
}

TEST(ViewerRate, ALongWayIsNotTakenForASlowLinkAtTheStart) {
  LongWay link;
  link.live(1, 400'000'000);
  EXPECT_GT(link.rate.bytes_per_s(), 900'000);
}

TEST(ViewerRate, ASenderThatIsLateIsNotTakenForASlowLink) {
  LongWay link;
  link.live(10, 20'000'000);
  link.live(20, 20'000'000, 300'000'000);
  EXPECT_GT(link.rate.bytes_per_s(), 900'000);
  link.live(20, 20'000'000, 450'000'000);
  EXPECT_GT(link.rate.bytes_per_s(), 900'000);
}

TEST(ViewerRate, AWayThatGrowsLongUnderATrickleSaysNothingOfTheLink) {
  ViewerRate rate;
  std::int64_t now_ns = kSecond;
  rate.set(8000, 0, now_ns);
  std::deque<std::int64_t> sent_ns;
  std::uint64_t sent = 0, come = 0;
  for (int step = 0; step < 1200; ++step, now_ns += kStep) {
    const std::int64_t way_ns = step < 600 ? 20'000'000 : 520'000'000;
    if (step % 5 == 0 && rate.available(now_ns) >= 750 && rate.has_room(750, now_ns)) {
      rate.take(++sent, 750, now_ns);
      sent_ns.push_back(now_ns);
      rate.rest();
    }
    while (!sent_ns.empty() && now_ns - sent_ns.front() >= way_ns) {
      sent_ns.pop_front();
      ++come;
    }
    if (step % 15 == 0) rate.acknowledged(come, now_ns);
  }
  EXPECT_GT(rate.bytes_per_s(), 900'000);
}

// It was assumed to take far more, and all that there is to send is on the way at once, where it queues.
TEST(ViewerRate, ASlowLinkIsFoundAlsoWhereNothingWaitsToBeSent) {
  constexpr double kPacket = 4000, kLink = 250'000;  // bytes, a second
  constexpr int kStepsApart = 20;                    // of what is offered: 100 kB each time
  ViewerRate rate;
  std::int64_t now_ns = kSecond;
  rate.set(9000, 0, now_ns);
  double offered = 0, queued = 0, passed = 0;
  std::uint64_t sent = 0;
  for (int step = 0; step < 400; ++step, now_ns += kStep) {
    if (step % kStepsApart == 0) offered = std::min(offered + 100'000, 200'000.0);
    while (offered >= kPacket && rate.available(now_ns) >= kPacket && rate.has_room(kPacket, now_ns)) {
      rate.take(++sent, kPacket, now_ns);
      offered -= kPacket;
      queued += kPacket;
    }
    if (offered < kPacket) rate.rest();
    const double bytes = std::min(queued, kLink / 100);
    queued -= bytes;
    passed += bytes;
    if (step % 15 == 0) rate.acknowledged(static_cast<std::uint64_t>(passed / kPacket), now_ns);
  }
  EXPECT_LT(rate.bytes_per_s(), 1.5 * kLink);
  EXPECT_LT(queued, 0.5 * kLink);
}

// What is larger than the burst is paid for afterwards, and the bucket alone would let two of those pass in one second.
TEST(ViewerRate, NoSecondHasMoreThanATenthAboveALowRate) {
  for (const double kbps : {100.0, 300.0}) {
    for (const double packet : {200.0, 3000.0, 6500.0, 9500.0}) {
      ViewerRate rate;
      rate.set(kbps, 0, kSecond);
      std::deque<double> sent;  // so far, at each step
      double all = 0, largest = 0;
      std::uint64_t sequence = 0;
      for (std::int64_t now_ns = kSecond; now_ns < 61 * kSecond; now_ns += kStep) {
        while (rate.available(now_ns) >= std::min(packet, 0.999 * rate.burst()) &&
               rate.second_has_room(packet, 1.1, now_ns)) {
          rate.take(++sequence, packet, now_ns);
          all += packet;
        }
        rate.acknowledged(sequence, now_ns);
        sent.push_back(all);
        if (sent.size() > 100) {
          largest = std::max(largest, sent.back() - sent.front());
          sent.pop_front();
        }
      }
      EXPECT_LE(largest, 1.1 * kbps * 125) << kbps << ", " << packet;
      EXPECT_GT(all, 0.5 * kbps * 125 * 60) << kbps << ", " << packet << ": the rate was not used";
    }
  }
}

// The bucket holds 12.5 kB, and what is larger goes when that is there.
TEST(ViewerRate, WhatIsLargerThanTheBurstTakesNoMoreThanTheRate) {
  constexpr double kBytes_s = 125'000, kSeconds = 10;
  for (const double packet : {13'000.0, 20'000.0, 60'000.0}) {
    ViewerRate rate;
    rate.set(1000, 0, kSecond);
    double all = 0;
    std::uint64_t sequence = 0;
    for (std::int64_t now_ns = kSecond; now_ns < kSecond + static_cast<std::int64_t>(kSeconds * 1e9); now_ns += kStep) {
      if (rate.available(now_ns) < std::min(packet, 0.999 * rate.burst())) continue;
      rate.take(++sequence, packet, now_ns);
      all += packet;
    }
    EXPECT_LE(all, kBytes_s * kSeconds + packet) << packet;
    EXPECT_GT(all, 0.9 * kBytes_s * kSeconds) << packet << ": the rate was not used";
  }
}

TEST(ViewerRate, WhatIsLargerThanASecondDoesNotWaitForKeepalivesToEnd) {
  ViewerRate rate;
  rate.set(100, 0, kSecond);
  rate.take(1, 160, kSecond);
  EXPECT_TRUE(rate.second_has_room(40'000, 1.1, 2 * kSecond - 1));
  rate.take(2, 40'000, 2 * kSecond);
  EXPECT_FALSE(rate.second_has_room(1000, 1.1, 3 * kSecond - 1));
}

TEST(ViewerRate, LessThanTheLeastRateIsTakenForThat) {
  ViewerRate rate;
  rate.set(1, 0, kSecond);
  EXPECT_EQ(rate.bytes_per_s(), 125 * ViewerRate::kLeastKbps);
}

TEST(ViewerRate, WhoGoesOnHasSpentWhatItHas) {
  ViewerRate before, after;
  before.set(1000, 0, kSecond);
  before.take(1, 20'000, kSecond);
  after.begin_with(before.spent());
  after.set(1000, 0, kSecond);
  EXPECT_EQ(after.available(kSecond), 0);
  EXPECT_FALSE(after.second_has_room(120'000, 1.1, kSecond));
  EXPECT_GT(after.available(2 * kSecond), 0);
}

TEST(ViewerRate, TakesNoMoreThanTheViewerWants) {
  Link link(2000);
  for (int k = 0; k < 100; ++k) {
    link.pass(4'000'000);
    ASSERT_LE(link.rate.bytes_per_s(), 250'000);
  }
  EXPECT_GT(link.rate.bytes_per_s(), 200'000);
}

}  // namespace
}  // namespace splatbus::streamer

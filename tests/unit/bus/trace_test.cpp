#include "bus/trace.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <string>
#include <thread>

#include "bus/clock.h"

namespace splatbus::bus {
namespace {

constexpr std::int64_t kLong = 60'000'000'000;

class TracedWorkTest : public testing::Test {
 protected:
  ~TracedWorkTest() override {
    SpanLog::of_process().record_until(0);
    static_cast<void>(SpanLog::of_process().take());
  }
};

TEST_F(TracedWorkTest, KeepsNothingUnlessSomebodyAsked) {
  SpanLog& log = SpanLog::of_process();
  EXPECT_FALSE(log.records());
  { const TracedWork work("unasked", 3); }
  log.record_until(now_ns() - 1);
  { const TracedWork work("too late", 3); }
  EXPECT_TRUE(log.take().spans.empty());

  log.record_until(now_ns() + kLong);
  const std::int64_t before = now_ns();
  { const TracedWork work("asked", 3, 4); }
  const std::int64_t after = now_ns();
  std::uint32_t other = 0;
  std::thread([&] {
    other = static_cast<std::uint32_t>(::gettid());
    TracedWork work("elsewhere");
    work.is_of(5, 6);
  }).join();
  const auto spans = log.take().spans;
  ASSERT_EQ(spans.size(), 2U);
  EXPECT_EQ(std::string(spans[0].name), "asked");
  EXPECT_GE(spans[0].begin_ns, before);
  EXPECT_GE(spans[0].end_ns, spans[0].begin_ns);
  EXPECT_LE(spans[0].end_ns, after);
  EXPECT_EQ(spans[0].capture_ns, 3);
  EXPECT_EQ(spans[0].scene_version, 4U);
  EXPECT_EQ(spans[0].thread, static_cast<std::uint32_t>(::gettid()));
  EXPECT_EQ(spans[1].capture_ns, 5);
  EXPECT_EQ(spans[1].scene_version, 6U);
  EXPECT_EQ(spans[1].thread, other);
  EXPECT_TRUE(log.take().spans.empty());
}

TEST_F(TracedWorkTest, IsBoundedAndCountsWhatHasNoRoom) {
  SpanLog& log = SpanLog::of_process();
  log.record_until(now_ns() + kLong);
  for (std::size_t i = 0; i < SpanLog::kMaxSpans + 5; ++i) const TracedWork work("many");
  const SpanLog::Taken taken = log.take();
  EXPECT_EQ(taken.spans.size(), SpanLog::kMaxSpans);
  EXPECT_EQ(taken.lost, 5U);
  EXPECT_EQ(log.take().lost, 0U);
}

}  // namespace
}  // namespace splatbus::bus

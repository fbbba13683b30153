// Figures of several streamers, and of those that are gone.
#include "gateway/metrics.h"
#include "gateway_fixture.h"
#include "wire/stream_generated.h"

namespace splatbus::gateway_test {
namespace {

using testing::HasSubstr;

class SeveralStreamers : public bus_test::BusTest {
 protected:
  SeveralStreamers() : view_(connect("gateway")), publisher_(connect("streamer")) {}

  gateway::PipelineView view_;
  gateway::Traffic traffic_;
  bus::Publisher publisher_;
};

/// As a streamer whose figures are all multiples of `unit`, also its stream's epoch.
void say(const bus::Publisher& publisher, std::uint32_t unit, const char* body = "Page", std::uint64_t version = 0) {
  publisher.publish(topics::kStreamStats, [&](auto& builder, auto header) {
    const auto types_at = builder.CreateVector(std::vector<flatbuffers::Offset<wire::PacketBytes>>{
        wire::CreatePacketBytesDirect(builder, "Scene", 10 * unit, 1, 11 * unit),
        wire::CreatePacketBytesDirect(builder, body, 12 * unit, 1, 13 * unit)});
    wire::StreamStatsBuilder stats(builder);
    stats.add_header(header);
    stats.add_stream_epoch(unit);
    stats.add_version(version);
    stats.add_gaussians(unit);
    stats.add_viewers(2 * unit);
    stats.add_total_bytes(3 * unit);
    stats.add_whole_pages(4 * unit);
    stats.add_lost_packets(5 * unit);
    stats.add_lost_viewers(6 * unit);
    stats.add_wire_mbps(7 * unit);
    stats.add_wire_mbps_mean(8 * unit);
    stats.add_wire_mbps_peak(9 * unit);
    stats.add_by_type(types_at);
    return stats.Finish();
  });
}

TEST_F(SeveralStreamers, AreTheirSumsAndTheModelIsTheNewestsOne) {
  // "streamer", which is asked first, has the newer model.
  const bus::Publisher second(connect("streamer-2"));
  std::optional<gateway::StreamFigures> all;
  ASSERT_TRUE(bus_test::eventually([&] {
    say(publisher_, 100, "Page");
    say(second, 1, "PageDelta");
    view_.poll(bus::now_ns());
    all = view_.stream(bus::now_ns());
    return all && all->by_type.contains("Page") && all->by_type.contains("PageDelta");
  }));
  EXPECT_EQ(all->epoch, 100U);
  EXPECT_EQ(all->gaussians, 100U);
  EXPECT_EQ(all->viewers, 202U);
  EXPECT_EQ(all->total_bytes, 303U);
  EXPECT_EQ(all->whole_pages, 404U);
  EXPECT_EQ(all->lost_packets, 505U);
  EXPECT_EQ(all->lost_viewers, 606U);
  EXPECT_EQ(all->wire_mbps, 707);
  EXPECT_EQ(all->wire_mbps_mean, 808);
  EXPECT_EQ(all->wire_mbps_peak, 909);
  EXPECT_EQ(all->by_type.at("Scene").bytes, 1010U);
  EXPECT_EQ(all->by_type.at("Scene").packets, 1111U);
  EXPECT_EQ(all->by_type.at("Page").bytes, 1200U);
  EXPECT_EQ(all->by_type.at("PageDelta").packets, 13U);
}

class StreamCounters : public SeveralStreamers {
 protected:
  /// Until all that it said is heard, `now_ns_` being the time: nothing of it comes later. `unit`: none is larger.
  [[nodiscard]] bool hear(const bus::Publisher& publisher, std::uint32_t unit) {
    return bus_test::eventually([&] {
      say(publisher, unit, "Page", ++said_);
      return bus_test::eventually(
          [&] {
            view_.poll(now_ns_);
            const auto all = view_.stream(now_ns_);
            return all && all->epoch == unit && all->version == said_;
          },
          std::chrono::milliseconds(100));
    });
  }
  /// Of the units that were counted, as every counter has them.
  void expect_counted(std::uint64_t units) {
    const auto all = view_.stream(now_ns_);
    ASSERT_TRUE(all);
    EXPECT_EQ(all->total_bytes, 3 * units);
    EXPECT_EQ(all->whole_pages, 4 * units);
    EXPECT_EQ(all->lost_packets, 5 * units);
    EXPECT_EQ(all->lost_viewers, 6 * units);
    EXPECT_EQ(all->by_type.at("Scene").bytes, 10 * units);
    EXPECT_EQ(all->by_type.at("Page").packets, 13 * units);
    const std::string line = "splatbus_stream_lost_viewers_total " + std::to_string(6 * units) + "\n";
    EXPECT_THAT(gateway::metrics_text(view_, traffic_, now_ns_), HasSubstr(line));
  }
  void wait_until_silent() { now_ns_ += 11'000'000'000; }

  std::int64_t now_ns_ = bus::now_ns();
  std::uint64_t said_ = 0;
};

TEST_F(StreamCounters, DoNotFallWhenAStreamerEnds) {
  ASSERT_TRUE(hear(publisher_, 1));
  {
    const bus::Publisher second(connect("streamer-2"));
    ASSERT_TRUE(hear(second, 100));
    expect_counted(101);
  }
  wait_until_silent();
  ASSERT_TRUE(hear(publisher_, 2));
  expect_counted(102);
  EXPECT_EQ(view_.stream(now_ns_)->viewers, 4U);
}

TEST_F(StreamCounters, GoOnWhenAStreamerStartsAnewUnderItsName) {
  std::uint64_t all = 0;
  for (const std::uint32_t unit : {5, 1, 9}) {  // the last has counted more than the one before when it is first heard
    const bus::Publisher publisher(connect("streamer-2"));
    ASSERT_TRUE(hear(publisher, unit));
    expect_counted(all += unit);
  }
}

TEST_F(StreamCounters, CountAStreamerOnceThatWasSilent) {
  ASSERT_TRUE(hear(publisher_, 5));
  wait_until_silent();
  EXPECT_FALSE(view_.stream(now_ns_));
  ASSERT_TRUE(hear(publisher_, 7));
  expect_counted(7);
}

TEST_F(StreamCounters, AreOfAsManyStreamersAsThereIsRoomForAndThoseThatWere) {
  constexpr std::uint32_t kMost = 64;
  for (std::uint32_t unit = 1; unit <= kMost; ++unit) {
    ASSERT_TRUE(hear(bus::Publisher(connect("streamer-" + std::to_string(unit))), unit)) << unit;
  }
  constexpr std::uint64_t kAll = kMost * (kMost + 1) / 2;
  expect_counted(kAll);
  const bus::Publisher other(connect("streamer-other"));
  wait_until_silent();
  ASSERT_TRUE(hear(other, kMost + 1));
  expect_counted(kAll + kMost + 1);
}

}  // namespace
}  // namespace splatbus::gateway_test

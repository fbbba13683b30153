#include "stream_figures.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include "process_memory.h"
#include "stream_sheets.h"

namespace splatbus::cli {
namespace {

constexpr std::int64_t kBegin = 5'000'000'000;

Arrival arrival(double time_s, wire::Body body, std::size_t bytes) {
  return {.at_ns = kBegin + static_cast<std::int64_t>(time_s * 1e9), .body = body, .bytes = bytes};
}

// 125,000 bytes are a megabit.
const std::vector<Arrival> kArrivals{
    arrival(-0.5, wire::Body::Page, 999'999'999), arrival(0.1, wire::Body::Page, 250'000),
    arrival(0.9, wire::Body::PageDelta, 125'000), arrival(1.05, wire::Body::PageDelta, 125'000),
    arrival(1.85, wire::Body::Scene, 125'000),    arrival(3.5, wire::Body::PageDelta, 375'000),
    arrival(4.1, wire::Body::Page, 999'999'999)};

TEST(StreamFigures, BitsFallIntoTheirSecondAndType) {
  const BitsBySecond bits = megabits_by_second(kArrivals, kBegin, {.from_s = 0, .to_s = 4.4});
  ASSERT_EQ(bits.size(), 3U) << "only types that came";
  EXPECT_EQ(bits.at(wire::Body::Page), (std::vector<double>{2, 0, 0, 0}));
  EXPECT_EQ(bits.at(wire::Body::PageDelta), (std::vector<double>{1, 1, 0, 3})) << "whole seconds only";
  EXPECT_EQ(bits.at(wire::Body::Scene), (std::vector<double>{0, 1, 0, 0}));
  EXPECT_EQ(total_of(bits), (std::vector<double>{3, 2, 0, 3}));
  EXPECT_TRUE(megabits_by_second(kArrivals, kBegin, {.from_s = 0, .to_s = 0.9}).empty());
}

TEST(StreamFigures, ThePeakIsOfAnySecondWhereverItBegins) {
  // By whole seconds the most is 3; from 0.9 to 1.9 there are 1 + 1 + 1, from 0.1 to 1.1 2 + 1 + 1.
  EXPECT_DOUBLE_EQ(peak_megabits(kArrivals, kBegin, {.from_s = 0, .to_s = 4}), 4);
  EXPECT_DOUBLE_EQ(peak_megabits(kArrivals, kBegin, {.from_s = 0.5, .to_s = 4}), 3);
  EXPECT_DOUBLE_EQ(peak_megabits({}, kBegin, {.from_s = 0, .to_s = 4}), 0);
}

TEST(StreamFigures, MedianIsTheMiddle) {
  EXPECT_DOUBLE_EQ(*median({5, 1, 3}), 3);
  EXPECT_DOUBLE_EQ(*median({4, 1, 3, 100}), 3.5);
  EXPECT_FALSE(median({}));
}

StreamResults results() {
  StreamResults results{.link = "relay: 5 Mbit/s", .mbps = 5, .begin_ns = kBegin, .end_s = 4, .whole_s = 1};
  results.arrivals = kArrivals;
  results.samples = {{.time_s = 0.5, .ssim_server = 0.9, .ssim_viewer = 0.1},
                     {.time_s = 1.5, .ssim_server = 0.96, .ssim_viewer = 0.95},
                     {.time_s = 3, .ssim_server = 0.98, .ssim_viewer = 0.93}};
  results.server = {{.time_s = 1.2, .viewers = 1, .tick_ms = 10, .cpu_share = 0.2, .resident_mb = 100},
                    {.time_s = 2.2, .viewers = 11, .tick_ms = 14, .cpu_share = 0.4, .resident_mb = 115},
                    {.time_s = 3.2, .viewers = 11, .tick_ms = 12, .cpu_share = 0.6, .resident_mb = 125}};
  results.stages = {{.viewers = 1, .from_s = 1, .to_s = 2, .whole = 0},
                    {.viewers = 11, .from_s = 2, .to_s = 4, .whole = 10}};
  results.deliveries = {{.encoded_ns = kBegin, .there_ns = kBegin + 900'000'000},  // before the first whole picture
                        {.encoded_ns = kBegin + 1'990'000'000, .there_ns = kBegin + 2'000'000'000},
                        {.encoded_ns = kBegin + 2'000'000'000, .there_ns = kBegin + 2'900'000'000, .whole = true},
                        {.encoded_ns = kBegin + 2'970'000'000, .there_ns = kBegin + 3'000'000'000},
                        {.encoded_ns = kBegin + 3'480'000'000, .there_ns = kBegin + 3'500'000'000}};
  results.tick_hz = 5;
  results.gaussians = 4321;
  results.join = {.first_s = 0.25, .whole_s = 1.5, .near_s = 0.5, .close_s = {}};
  return results;
}

TEST(StreamFigures, TheSummaryIsOfWhatCameAfterTheFirstWholePicture) {
  const nlohmann::json summary = summarize_stream(results());
  EXPECT_EQ(summary["gaussians"], 4321);
  // Seconds from 1 on: 2, 0 and 3 megabits.
  EXPECT_DOUBLE_EQ(summary["mbps_mean"], 1.66667);
  EXPECT_DOUBLE_EQ(summary["mbps_median"], 2);
  EXPECT_DOUBLE_EQ(summary["mbps_peak"], 3);
  EXPECT_DOUBLE_EQ(summary["mbps_by_type"]["PageDelta"], 1.33333);
  EXPECT_FALSE(summary["mbps_by_type"].contains("Page"));
  EXPECT_DOUBLE_EQ(summary["ssim_server"], 0.97);
  EXPECT_DOUBLE_EQ(summary["ssim_viewer"], 0.94);
  EXPECT_DOUBLE_EQ(summary["ssim_gap_worst"], 0.05);
  EXPECT_DOUBLE_EQ(summary["join_first_s"], 0.25);
  EXPECT_DOUBLE_EQ(summary["join_whole_s"], 1.5);
  EXPECT_TRUE(summary["join_close_s"].is_null());
  // Half a tick's period, the median tick, the median way of a delta: 100 + 12 + 20.
  EXPECT_DOUBLE_EQ(summary["latency_ms"], 132);
  EXPECT_DOUBLE_EQ(summary["link_mbps"], 5);
}

TEST(StreamFigures, AViewerThatNeverHadEverythingIsJudgedFromHalfOfTheRunOn) {
  StreamResults never = results();
  never.whole_s.reset();
  const nlohmann::json summary = summarize_stream(never);
  EXPECT_TRUE(summary["first_whole_s"].is_null());
  EXPECT_DOUBLE_EQ(summary["judged_s"], 2);
  EXPECT_DOUBLE_EQ(summary["ssim_viewer"], 0.93);
}

TEST(StreamFigures, StagesTellWhatAViewerCostsTheServer) {
  const nlohmann::json summary = summarize_stream(results());
  ASSERT_EQ(summary["stages"].size(), 2U);
  EXPECT_DOUBLE_EQ(summary["stages"][0]["tick_ms"], 10);
  EXPECT_DOUBLE_EQ(summary["stages"][1]["tick_ms"], 13);
  EXPECT_DOUBLE_EQ(summary["stages"][1]["cpu_share"], 0.5);
  EXPECT_EQ(summary["stages"][1]["whole"], 10);
  EXPECT_DOUBLE_EQ(summary["resident_mb_a_viewer"], 2) << "(120 - 100) / (11 - 1)";
}

TEST(StreamFigures, WithoutMeasurementsThereAreNulls) {
  const nlohmann::json summary = summarize_stream({});
  for (const char* key : {"mbps_mean", "mbps_peak", "ssim_server", "ssim_viewer", "ssim_gap_worst", "join_first_s",
                          "join_whole_s", "latency_ms"}) {
    EXPECT_TRUE(summary[key].is_null()) << key;
  }
}

TEST(StreamSheets, TablesHaveARowAFigure) {
  const std::vector<NamedStream> runs{{.name = "stream", .results = results()}};
  EXPECT_EQ(stream_csv(runs),
            "run,time_s,ssim_server,ssim_viewer\nstream,0.500,0.90000,0.10000\nstream,1.500,0.96000,0.95000\n"
            "stream,3.000,0.98000,0.93000\n");
  EXPECT_NE(bitrate_csv(runs).find("\nstream,3,PageDelta,3\n"), std::string::npos) << bitrate_csv(runs);
  EXPECT_NE(server_csv(runs).find("\nstream,2.200,11,14.000,0.4000,115.000\n"), std::string::npos);
}

TEST(ProcessMemory, ProcessorTimeGrowsWithWork) {
  const auto before = processor_seconds(getpid());
  ASSERT_TRUE(before);
  volatile double sum = 0;
  while (*processor_seconds(getpid()) < *before + 0.05) {
    for (int i = 0; i < 100'000; ++i) sum = sum + i;
  }
  EXPECT_FALSE(processor_seconds(-1));
}

}  // namespace
}  // namespace splatbus::cli

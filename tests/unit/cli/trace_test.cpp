#include <gmock/gmock.h>

#include <filesystem>
#include <fstream>
#include <set>

#include "../bus/bus_fixture.h"
#include "bus_watch.h"
#include "child_process.h"
#include "run_verb.h"
#include "trace_events.h"

namespace splatbus::cli {
namespace {

using Json = nlohmann::json;
using testing::ElementsAre;

std::vector<TracedSpan> spans() {
  return {
      {.source = "viewer", .name = "draw", .pid = 5, .thread = 5, .begin_ns = 9000, .end_ns = 9500, .capture_ns = 1400},
      {.source = "engine",
       .name = "submit",
       .pid = 1,
       .thread = 1,
       .begin_ns = 1000,
       .end_ns = 1500,
       .capture_ns = 1000},
      {.source = "bridge",
       .name = "forward",
       .pid = 2,
       .thread = 3,
       .begin_ns = 2000,
       .end_ns = 2500,
       .capture_ns = 1000,
       .scene_version = 7},
      {.source = "bridge",
       .name = "forward",
       .pid = 2,
       .thread = 3,
       .begin_ns = 3000,
       .end_ns = 3500,
       .capture_ns = 2900,
       .scene_version = 7},
      {.source = "relight",
       .name = "compute",
       .pid = 4,
       .thread = 4,
       .begin_ns = 2600,
       .end_ns = 2800,
       .scene_version = 7},
      {.source = "trainer",
       .name = "step",
       .pid = 3,
       .thread = 9,
       .begin_ns = 4000,
       .end_ns = 5000,
       .scene_version = 7},
      {.source = "trainer",
       .name = "step",
       .pid = 3,
       .thread = 9,
       .begin_ns = 5000,
       .end_ns = 6000,
       .scene_version = 8},
      {.source = "trainer",
       .name = "step",
       .pid = 3,
       .thread = 9,
       .begin_ns = 6000,
       .end_ns = 7000,
       .scene_version = 7}};
}

TEST(TraceEvents, FindTheFrameOfEachSpan) {
  auto all = spans();
  assign_frames(all);
  std::vector<std::int64_t> frames;
  for (const TracedSpan& span : all) frames.push_back(span.capture_ns);
  // submit, forward, compute (of the version, before the next frame), forward, step, step (unknown version), step, draw
  EXPECT_THAT(frames, ElementsAre(1000, 1000, 1000, 2900, 2900, 0, 2900, 1000));

  const auto ways = ways_of_frames(all);
  ASSERT_EQ(ways.size(), 2U);
  std::vector<std::string> first, second;
  for (const TracedSpan* span : ways.at(1000)) first.push_back(span->source);
  for (const TracedSpan* span : ways.at(2900)) second.push_back(span->source);
  EXPECT_THAT(first, ElementsAre("engine", "bridge", "relight", "viewer"));
  EXPECT_THAT(second, ElementsAre("bridge", "trainer")) << "of many steps the first";
}

TEST(TraceEvents, AreSlicesNamesAndArrows) {
  auto all = spans();
  assign_frames(all);
  const Json trace = trace_events(all);
  std::map<std::string, int> phases;
  std::map<std::uint64_t, std::vector<Json>> arrows;
  std::map<std::uint32_t, std::string> processes;
  for (const Json& event : trace.at("traceEvents")) {
    const std::string phase = event.at("ph");
    ++phases[phase];
    if (phase == "s" || phase == "f") arrows[event.at("id")].push_back(event);
    if (phase == "M" && event["name"] == "process_name") processes[event["pid"]] = event["args"]["name"];
  }
  EXPECT_EQ(phases["X"], 8);
  EXPECT_EQ(processes.size(), 5U);
  EXPECT_EQ(processes[2], "bridge");
  EXPECT_EQ(arrows.size(), 3U + 1U);
  for (const auto& [id, ends] : arrows) {
    ASSERT_EQ(ends.size(), 2U);
    EXPECT_EQ(ends[0]["ph"], "s");
    EXPECT_EQ(ends[1]["bp"], "e");
    EXPECT_LE(ends[0]["ts"], ends[1]["ts"]);
    for (const Json& end : ends) {
      const bool within = std::any_of(all.begin(), all.end(), [&](const TracedSpan& span) {
        const double at_ns = end["ts"].get<double>() * 1e3;
        return end["pid"] == span.pid && end["tid"] == span.thread && at_ns >= static_cast<double>(span.begin_ns) &&
               at_ns <= static_cast<double>(span.end_ns);
      });
      EXPECT_TRUE(within) << end << " is bound to nothing";
    }
  }
  for (const Json& event : trace.at("traceEvents")) {
    if (event["ph"] != "X" || event["name"] != "compute") continue;
    EXPECT_DOUBLE_EQ(event["ts"], 2.6) << "microseconds";
    EXPECT_DOUBLE_EQ(event["dur"], 0.2);
    EXPECT_DOUBLE_EQ(event["args"]["since_capture_ms"], 0.0016);
  }
}

class TraceVerb : public bus_test::BusTest {};

TEST_F(TraceVerb, KeepsTheEarlierTraceWhereThereIsNoBus) {
  broker_->stop();
  const std::string path = directory_.path() + "/trace.json";
  std::ofstream(path) << "earlier";
  const std::vector<std::string> arguments{"trace", "--out", path, "--bus", directory_.address().text()};
  EXPECT_THROW(run_verb(add_trace_verb, arguments), std::runtime_error);
  std::ifstream file(path);
  EXPECT_EQ(std::string(std::istreambuf_iterator<char>(file), {}), "earlier");
}

TEST_F(TraceVerb, LeavesNoFileWhereNothingWasTraced) {
  const std::string path = directory_.path() + "/trace.json";
  const std::vector<std::string> arguments{
      "trace", "--seconds", "0.1", "--out", path, "--bus", directory_.address().text()};
  EXPECT_THROW(run_verb(add_trace_verb, arguments), std::runtime_error);
  EXPECT_FALSE(std::filesystem::exists(path));
  std::ofstream(path) << "earlier";
  EXPECT_THROW(run_verb(add_trace_verb, arguments), std::runtime_error);
  std::ifstream file(path);
  EXPECT_EQ(std::string(std::istreambuf_iterator<char>(file), {}), "earlier");
}

TEST_F(TraceVerb, CollectsWhatServicesDoWhileItRuns) {
  const std::string bus = directory_.address().text();
  const ChildProcess service(std::string(SPLATBUS_BIN_DIR) + "/bus-test-service", {"--bus", bus, "--name", "test-1"},
                             {});
  BusWatch watch(connect("tester"));
  ASSERT_TRUE(bus_test::eventually([&] {
    watch.follow(std::chrono::milliseconds(20));
    return watch.nodes().contains("test-1") && watch.nodes().at("test-1").state == "Running";
  }));
  const std::string path = directory_.path() + "/trace.json";
  const std::string text = run_verb(add_trace_verb, {"trace", "--seconds", "2", "--out", path, "--bus", bus});
  EXPECT_THAT(text, testing::HasSubstr("of 1 processes"));
  std::ifstream file(path);
  const Json trace = Json::parse(file);
  int turns = 0;
  for (const Json& event : trace["traceEvents"]) {
    if (event["ph"] != "X") continue;
    ++turns;
    EXPECT_EQ(event["name"], "turn");
    EXPECT_EQ(event["pid"], service.pid());
    EXPECT_EQ(event["args"]["scene_version"], 7);
    EXPECT_GE(event["dur"], 1000) << "it sleeps in between";
  }
  EXPECT_GT(turns, 5);

  // Nobody goes on when nobody asks.
  bus::Subscriber spans(connect("spans"), {"sys/spans"});
  ASSERT_TRUE(spans.wait_connected(std::chrono::seconds(60)));
  const double before = watch.nodes().at("test-1").counters.at("turns");
  ASSERT_TRUE(bus_test::eventually([&] {
    watch.follow(std::chrono::milliseconds(20));
    return watch.nodes().at("test-1").counters.at("turns") > before + 50;
  }));
  EXPECT_FALSE(spans.receive(std::chrono::milliseconds(0)).has_value());
}

}  // namespace
}  // namespace splatbus::cli

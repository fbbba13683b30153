#include <fcntl.h>
#include <gmock/gmock.h>

#include "../bus/bus_fixture.h"
#include "child_process.h"
#include "program_in_terminal.h"
#include "run_verb.h"
#include "top_table.h"

namespace splatbus::cli {
namespace {

using Json = nlohmann::json;
using testing::ElementsAre;
using testing::HasSubstr;

TEST(Top, SortsByWhatIsAskedFor) {
  TopView view;
  view.services = {{.name = "b", .processor_percent = 5, .memory_bytes = 10, .rate_hz = 1, .drops = 3},
                   {.name = "a", .memory_bytes = 30, .rate_hz = 9},
                   {.name = "c", .processor_percent = 70, .rate_hz = 2, .drops = 1}};
  const auto names = [&](TopOrder order) {
    sort_services(view, order);
    std::vector<std::string> result;
    for (const TopService& service : view.services) result.push_back(service.name);
    return result;
  };
  EXPECT_THAT(names(TopOrder::Name), ElementsAre("a", "b", "c"));
  EXPECT_THAT(names(TopOrder::Processor), ElementsAre("c", "b", "a")) << "what is not known comes last";
  EXPECT_THAT(names(TopOrder::Memory), ElementsAre("a", "b", "c"));
  EXPECT_THAT(names(TopOrder::Rate), ElementsAre("a", "c", "b"));
  EXPECT_THAT(names(TopOrder::Drops), ElementsAre("b", "c", "a"));
}

TEST(Top, CountsWhatWasLostAndNotWhatWasLeftOut) {
  NodeState node;
  node.counters = {{"frames_lost", 1},      {"rounds_lost", 2}, {"inline_dropped", 4}, {"malformed", 8},
                   {"samples_dropped", 16}, {"frames", 32},     {"lost_dropped", 64}};
  EXPECT_EQ(drops_of(node), 1 + 2 + 4 + 8 + 64) << "each counter once";
}

class TopVerb : public bus_test::BusTest {
 protected:
  TopVerb()
      : service_(std::string(SPLATBUS_BIN_DIR) + "/bus-test-service", {"--bus", address(), "--name", "test-1"}, {}) {}
  [[nodiscard]] std::string address() const { return directory_.address().text(); }

  ChildProcess service_;
};

TEST_F(TopVerb, PrintsOneTableOfAll) {
  Json view;
  ASSERT_TRUE(bus_test::eventually([&] {
    view = Json::parse(run_verb(add_top_verb, {"top", "--once", "--json", "--bus", address()}));
    return view["services"].size() == 2 && view["services"][1]["state"] == "Running";
  }));
  EXPECT_GT(view["interval_s"], 0.1);
  const Json& service = view["services"][1];
  EXPECT_EQ(service["name"], "test-1");
  EXPECT_EQ(service["pid"], service_.pid());
  EXPECT_GT(service["own_memory_bytes"], 1 << 18);
  EXPECT_TRUE(service["processor_percent"].is_number()) << service;
  EXPECT_EQ(view["services"][0]["name"], "bus");
  for (const Json& topic : view["topics"]) {
    if (topic["topic"] == "test/model") {
      EXPECT_EQ(topic["readers"], 0) << "it looks at nobody's messages";
    }
    if (topic["topic"] != "sys/heartbeat") continue;
    EXPECT_GT(topic["rate_hz"], 2);
    // Both it and the broker publish heartbeats, and it little else by now.
    EXPECT_GT(service["rate_hz"], 2);
    EXPECT_TRUE(topic["transit_s"].is_number());
    EXPECT_TRUE(topic["age_s"].is_null()) << "a heartbeat is of no frame";
  }
  const std::string text = run_verb(add_top_verb, {"top", "--once", "--sort", "rate", "--bus", address()});
  for (const char* part : {"2 services", "SERVICE", "TOPIC", "test-1", "counting", "sys/heartbeat"}) {
    EXPECT_THAT(text, HasSubstr(part));
  }
}

TEST_F(TopVerb, DrawsAScreenAndGivesItBack) {
  ProgramInTerminal terminal({SPLATBUS_BIN_DIR "/inspect-test-verbs", "top", "--bus", address()});
  ASSERT_TRUE(terminal.read_until("test-1")) << terminal.all();
  EXPECT_THAT(terminal.all(), HasSubstr("\x1b[?1049h")) << "the other screen, so that what was there comes back";
  EXPECT_THAT(terminal.all(), HasSubstr("SERVICE"));
  EXPECT_THAT(terminal.all(), HasSubstr("sorted by name"));
  terminal.type("c");
  ASSERT_TRUE(terminal.read_until("cpu")) << terminal.all();
  terminal.type("q");
  ASSERT_TRUE(terminal.read_until("\x1b[?1049l")) << terminal.all();
  EXPECT_EQ(terminal.wait(), 0);
}

TEST_F(TopVerb, WhereNoTerminalIsSaysSo) {
  CLI::App app;
  Action action;
  add_top_verb(app, action);
  app.parse(std::vector<std::string>{address(), "--bus", "top"});
  const int out = ::dup(STDOUT_FILENO), none = ::open("/dev/null", O_WRONLY | O_CLOEXEC);
  ::dup2(none, STDOUT_FILENO);
  try {
    action();
    ADD_FAILURE();
  } catch (const std::runtime_error& error) {
    EXPECT_THAT(error.what(), HasSubstr("--once"));
  }
  ::dup2(out, STDOUT_FILENO);
  ::close(out);
  ::close(none);
}

}  // namespace
}  // namespace splatbus::cli

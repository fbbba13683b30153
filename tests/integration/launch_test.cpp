#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>

#include <csignal>
#include <filesystem>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <string>

#include "child_process.h"
#include "command.h"
#include "pipeline.h"

namespace splatbus::cli {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;
using testing::HasSubstr;

constexpr int kPatienceMs = 60000;

/// `splatbus launch` as a user runs it.
class LaunchedFile {
 public:
  LaunchedFile(const std::string& yaml, std::vector<std::string> options = {}) {
    path_ = folder_.path() / "test.yaml";
    std::ofstream(path_) << yaml;
    std::vector<std::string> arguments{"launch", path_.string(), "--json", "--bus", folder_.address().text()};
    arguments.insert(arguments.end(), options.begin(), options.end());
    child_.emplace(std::string(SPLATBUS_BIN_DIR) + "/splatbus", arguments, test_environment());
  }

  [[nodiscard]] ChildProcess& child() { return *child_; }
  [[nodiscard]] const fs::path& path() const { return path_; }
  [[nodiscard]] const std::vector<std::string>& lines() const { return lines_; }

  /// Until a line has all the texts, or the program ends.
  bool wait_for(const std::vector<std::string>& texts) {
    for (;;) {
      for (const std::string& line : lines_) {
        if (std::all_of(texts.begin(), texts.end(), [&](const auto& t) { return line.find(t) != std::string::npos; })) {
          return true;
        }
      }
      if (!read_more()) return false;
    }
  }

  ExitStatus wait_for_end() {
    while (read_more()) {
    }
    return child_->poll_exit().value_or(ExitStatus{.code = -1, .signal = 0});
  }

  /// Process ids of the events "started".
  [[nodiscard]] std::map<std::string, pid_t> started() const {
    std::map<std::string, pid_t> pids;
    for (const std::string& line : lines_) {
      const Json json = Json::parse(line, nullptr, false);
      if (json.is_object() && json.value("event", "") == "started") pids[json.at("service")] = json.at("pid");
    }
    return pids;
  }

 private:
  bool read_more() {
    if (child_->output_fd() < 0) {
      pollfd end{.fd = child_->exit_fd(), .events = POLLIN, .revents = 0};
      poll(&end, 1, kPatienceMs);
      return false;
    }
    pollfd output{.fd = child_->output_fd(), .events = POLLIN, .revents = 0};
    if (poll(&output, 1, kPatienceMs) <= 0) return false;
    for (std::string& line : child_->read_lines(true)) lines_.push_back(std::move(line));
    return true;
  }

  PrivateBusFolder folder_;
  fs::path path_;
  std::vector<std::string> lines_;
  std::optional<ChildProcess> child_;
};

bool is_gone(pid_t pid) {
  std::ifstream stat("/proc/" + std::to_string(pid) + "/stat");
  std::string number, name, state;
  // A killed orphan stays as a zombie until init collects it.
  return !(stat >> number >> name >> state) || state == "Z" || state == "X";
}

void expect_gone(const std::map<std::string, pid_t>& pids) {
  for (const auto& [name, pid] : pids) {
    const auto end = std::chrono::steady_clock::now() + std::chrono::milliseconds(kPatienceMs);
    while (!is_gone(pid) && std::chrono::steady_clock::now() < end) std::this_thread::yield();
    EXPECT_TRUE(is_gone(pid)) << name << ", process " << pid << ", is an orphan";
  }
}

class Interrupt : public testing::TestWithParam<int> {};

TEST_P(Interrupt, LeavesNoOrphan) {
  LaunchedFile launched(Pipeline::launch_file());
  for (const char* service :
       {"bus", "engine", "capture-bridge", "expander", "trainer", "relight", "streamer", "viewer", "gateway"}) {
    ASSERT_TRUE(launched.wait_for({"\"service\":" + Json(service).dump(), "\"event\":\"ready\""})) << service;
  }
  ASSERT_TRUE(launched.wait_for({"\"trainer\"", "\"line\""}));
  EXPECT_TRUE(launched.wait_for({"{\"url\":\"http://localhost:"})) << "where to look is said";
  const auto pids = launched.started();
  ASSERT_EQ(pids.size(), 9U);
  kill(launched.child().pid(), GetParam());
  const ExitStatus status = launched.wait_for_end();
  if (GetParam() == SIGKILL) {
    EXPECT_EQ(status.signal, SIGKILL);
  } else {
    EXPECT_EQ(status.text(), "exited with status 0");
    EXPECT_FALSE(launched.wait_for({"does not stop"}));
  }
  expect_gone(pids);
}

INSTANTIATE_TEST_SUITE_P(Signals, Interrupt, testing::Values(SIGINT, SIGTERM, SIGKILL),
                         [](const auto& instance) { return std::string("Signal") + std::to_string(instance.param); });

TEST(Launch, StopsByItselfAfterSeconds) {
  LaunchedFile launched("services:\n  - name: bus\n  - name: relight\n", {"--seconds", "1"});
  const ExitStatus status = launched.wait_for_end();
  // A second may be too short to get ready in: what does not run at the end is the exit status.
  const bool ready = launched.wait_for({"\"service\":\"relight\"", "\"event\":\"ready\""});
  EXPECT_EQ(status.text(), ready ? "exited with status 0" : "exited with status 1");
  expect_gone(launched.started());
}

TEST(Launch, FailureForGoodIsTheExitStatus) {
  LaunchedFile launched(
      "services:\n  - {name: job, program: /bin/false, restart: never}\n"
      "  - {name: relight, after: [job]}\n");
  EXPECT_EQ(launched.wait_for_end().text(), "exited with status 1");
  EXPECT_TRUE(launched.wait_for({"splatbus launch: job: failed, exited with status 1"}));
  EXPECT_TRUE(launched.wait_for({"waits for job, which failed"}));
}

struct BadFile {
  const char* name;
  const char* yaml;
  const char* message;  ///< after the path
};

class BadLaunchFile : public testing::TestWithParam<BadFile> {};

TEST_P(BadLaunchFile, IsRefusedBeforeAnythingStarts) {
  LaunchedFile launched(GetParam().yaml);
  EXPECT_EQ(launched.wait_for_end().text(), "exited with status 1");
  EXPECT_THAT(launched.lines(), testing::Contains(HasSubstr(launched.path().string() + GetParam().message)));
  EXPECT_TRUE(launched.started().empty());
}

const BadFile kBadFiles[] = {
    {"NotYaml", "services: [\n", ":2:1: not YAML"},
    {"UnknownKey", "services:\n  - name: bus\n    color: red\n", ":3:5: unknown key 'color' of service 'bus'"},
    {"UnknownService", "services:\n  - name: bus\n  - name: strimer\n", ":3:11: no program 'splatbus-strimer'"},
    {"UnknownParameter", "services:\n  - name: trainer\n    parameters:\n      batch: 2\n      bach: 2\n",
     ":5:13: service 'trainer': no parameter 'bach' to set to '2'; did you mean 'batch'?"},
    {"WrongType", "services:\n  - name: trainer\n    parameters: {batch: some}\n",
     ":3:25: service 'trainer': parameter 'batch' must be a whole number from 0 to 256, not 'some'"},
    {"OutOfRange", "services:\n  - name: trainer\n    parameters: {ssim_weight: 7}\n",
     ":3:31: service 'trainer': parameter 'ssim_weight' must be a number from 0 to 1, not '7'"},
    {"MistypedArgument", "services:\n  - {name: engine, program: splatbus-engine-sim, args: [--dynamcs]}\n",
     ":2:57: service 'engine' refuses its arguments: splatbus-engine-sim: unknown option '--dynamcs'; did you mean "
     "'--dynamics'?"},
    {"BusArgument", "services:\n  - {name: bus, args: [--tcp, nonsense]}\n", ":2:31: service 'bus' refuses"},
    {"BadEndpoint", "services:\n  - {name: streamer, endpoint: \"tcp:/*:7600\"}\n",
     ":2:32: service 'streamer': parameter 'endpoint' must be an endpoint"},
    {"NotTogether", "services:\n  - {name: gateway, parameters: {http: \"0.0.0.0:7680\"}}\n",
     ":2:12: service 'gateway': http: 0.0.0.0:7680 can be reached from other machines"},
    {"UnknownVariable", "services:\n  - {name: relight, args: [\"${nmae}\"]}\n",
     ":2:28: unknown variable '${nmae}'; did you mean 'name'?"},
    {"Cycle", "services:\n  - {name: trainer, after: [viewer]}\n  - {name: viewer, after: [trainer]}\n",
     ":3:28: circular `after`: trainer → viewer → trainer"},
    {"Duplicate", "services:\n  - name: bus\n  - name: bus\n", ":3:11: service name 'bus' is taken, first at"},
};

INSTANTIATE_TEST_SUITE_P(Cases, BadLaunchFile, testing::ValuesIn(kBadFiles),
                         [](const auto& instance) { return std::string(instance.param.name); });

TEST(Launch, BadOverridesAreRefused) {
  LaunchedFile unknown("services:\n  - name: relight\n", {"--set", "relite.bias=1"});
  EXPECT_EQ(unknown.wait_for_end().code, 1);
  EXPECT_THAT(unknown.lines(), testing::Contains(HasSubstr("--set relite.bias=1: ")));
  LaunchedFile refused("services:\n  - name: trainer\n", {"--set", "trainer.batch=x"});
  EXPECT_EQ(refused.wait_for_end().code, 1);
  EXPECT_THAT(refused.lines(),
              testing::Contains(HasSubstr("--set trainer.batch=x: service 'trainer': parameter 'batch' must be")));
}

TEST(Launch, ADryRunPrintsEveryProcessAndStartsNone) {
  const PrivateBusFolder folder;
  const fs::path path = folder.path() / "test.yaml";
  std::ofstream(path) << "arguments: {size: 160}\nservices:\n  - {name: viewer, after: [relight], parameters: {width: "
                         "\"${size}\"}}\n  - {name: relight, replicas: 2}\n  - name: bus\n";
  const std::string bus = folder.address().text();
  const Answer answer = splatbus_command({"launch", path.string(), "size=200", "--dry-run", "--json", "--bus", bus});
  ASSERT_TRUE(answer.status.success()) << answer.lines.front();
  ASSERT_EQ(answer.lines.size(), 4U);
  const Json viewer = answer.json().back();
  EXPECT_EQ(viewer.at("service"), "viewer");
  EXPECT_EQ(viewer.at("after"), Json({"bus", "relight-1", "relight-2"}));
  EXPECT_EQ(viewer.at("arguments"), Json({"--bus", bus, "--name", "viewer", "--set", "width=200"}));
  EXPECT_FALSE(fs::exists(folder.path() / "lock")) << "no broker was there";
}

TEST(Launch, ValidateNamesEveryProblemForEditors) {
  const PrivateBusFolder folder;
  const fs::path path = folder.path() / "test.yaml";
  std::ofstream(path) << "services:\n  - {name: trainer, parameters: {bach: 2, ssim_weight: 7}}\n";
  const Answer answer = splatbus_command({"launch", path.string(), "--validate", "--json"});
  EXPECT_EQ(answer.status.code, 1);
  ASSERT_EQ(answer.lines.size(), 1U);
  const Json report = answer.json().front();
  EXPECT_EQ(report.at("valid"), false);
  ASSERT_EQ(report.at("problems").size(), 2U);
  EXPECT_EQ(report.at("problems")[0].at("file"), path.string());
  EXPECT_EQ(report.at("problems")[0].at("line"), 2);
  EXPECT_EQ(report.at("problems")[0].at("column"), 40);
  EXPECT_THAT(report.at("problems")[0].at("message"), HasSubstr("did you mean 'batch'?"));
  EXPECT_EQ(report.at("problems")[1].at("column"), 56);
}

TEST(Commands, SayAtOnceThatThereIsNoBus) {
  const PrivateBusFolder folder;
  const std::string nowhere = "ipc://" + (folder.path() / "nowhere").string();
  const std::vector<std::vector<std::string>> verbs{{"topic", "list"}, {"topic", "hz"},   {"topic", "echo"},
                                                    {"node", "list"},  {"param", "list"}, {"export", "x.ply"}};
  for (std::vector<std::string> verb : verbs) {
    verb.insert(verb.end(), {"--bus", nowhere});
    const Answer answer = splatbus_command(verb);
    EXPECT_EQ(answer.status.code, 1) << verb[0];
    EXPECT_THAT(answer.lines, testing::Contains(HasSubstr("no bus at " + nowhere))) << verb[0];
  }
  EXPECT_EQ(splatbus_command({"lunch"}).status.code, 2);
}

TEST(Launch, ShippedFilesAreGood) {
  for (const auto& entry : fs::directory_iterator(fs::path(SPLATBUS_SOURCE_DIR) / "launch")) {
    if (entry.path().extension() != ".yaml") continue;
    const Answer answer = splatbus_command({"launch", entry.path().string(), "--validate"});
    EXPECT_TRUE(answer.status.success()) << entry.path();
    EXPECT_THAT(answer.lines, testing::ElementsAre(HasSubstr(": valid, ")));
  }
}

}  // namespace
}  // namespace splatbus::cli

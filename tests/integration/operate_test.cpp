// An operator's day: up in the background, look, change, save, restart, scale, swap, read the logs, down.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>

#include <csignal>
#include <filesystem>
#include <fstream>

#include "bus/file_descriptor.h"
#include "child_process.h"
#include "gateway_url.h"
#include "operated_bus.h"
#include "pipeline.h"

namespace splatbus::cli {
namespace {

using Json = nlohmann::json;
using testing::AllOf;
using testing::Contains;
using testing::HasSubstr;

constexpr std::chrono::seconds kPatience(90);

class OperatedPipeline : public OperatedBus {
 protected:
  /// Of `status --json`, by process.
  [[nodiscard]] std::map<std::string, Json> status() const {
    std::map<std::string, Json> result;
    const Answer answer = run({"status", "--json"});
    EXPECT_TRUE(answer.status.success()) << testing::PrintToString(answer.lines);
    if (!answer.status.success()) return result;
    const std::vector<Json> lines = answer.json();
    for (const Json& process : lines.at(0).at("services")) result[process.at("name")] = process;
    return result;
  }
  template <class Holds>
  [[nodiscard]] bool eventually(Holds holds) const {
    for (const auto end = std::chrono::steady_clock::now() + kPatience; std::chrono::steady_clock::now() < end;) {
      if (holds()) return true;
    }
    return false;
  }
  [[nodiscard]] pid_t pid_of(const std::string& name) const {
    const auto processes = status();
    const auto found = processes.find(name);
    return found == processes.end() ? 0 : found->second.value("pid", 0);
  }
};

TEST_F(OperatedPipeline, EveryVerbOnALivePipeline) {
  ASSERT_NO_FATAL_FAILURE(up(Pipeline::launch_file()));
  const auto first = status();
  ASSERT_EQ(first.size(), 9U);
  for (const auto& [name, process] : first) EXPECT_EQ(process.at("state"), "running") << name;
  EXPECT_EQ(run({"up", "-d", file()}).status.code, 1) << "one supervisor a bus";

  ChildProcess follower(std::string(SPLATBUS_BIN_DIR) + "/splatbus", {"logs", "-f", "relight", "--bus", bus()},
                        test_environment());
  std::vector<std::string> followed;
  const auto follow = [&](const std::string& text) {
    return eventually([&] {
      pollfd output{.fd = follower.output_fd(), .events = POLLIN, .revents = 0};
      poll(&output, 1, 100);
      for (std::string& line : follower.read_lines(false)) followed.push_back(std::move(line));
      return std::ranges::any_of(followed, [&](const auto& line) { return line.find(text) != std::string::npos; });
    });
  };
  EXPECT_TRUE(follow("started, process"));

  // Changed while it runs; refused with the range; saved, and there after a restart.
  expect_success({"param", "set", "relight", "softness_m", "0.25", "--save"});
  const Answer refused = run({"param", "set", "relight", "softness_m", "99"});
  EXPECT_EQ(refused.status.code, 1);
  EXPECT_THAT(refused.lines, Contains(HasSubstr("from 0 to 10")));
  expect_success({"param", "set", "trainer", "max_gaussians", "4096", "--save"});  // fixed while it runs
  const pid_t relight = first.at("relight").value("pid", 0), trainer = first.at("trainer").value("pid", 0);
  expect_success({"restart", "relight", "trainer"});
  EXPECT_NE(pid_of("relight"), relight);
  EXPECT_NE(pid_of("trainer"), trainer);
  EXPECT_THAT(run({"param", "get", "relight", "softness_m"}).lines, Contains("0.25"));
  EXPECT_THAT(run({"param", "get", "trainer", "max_gaussians"}).lines, Contains("4096"));

  // One more of it, whose log is followed from its start; and one less.
  expect_success({"scale", "relight=2"});
  EXPECT_EQ(status().at("relight-2").at("state"), "running");
  EXPECT_TRUE(follow("relight-2"));
  expect_success({"scale", "relight=1"});
  EXPECT_FALSE(status().contains("relight-2"));
  for (const std::string only : {"trainer", "expander"}) {
    const Answer second = run({"scale", only + "=2"});
    EXPECT_EQ(second.status.code, 1);
    EXPECT_THAT(second.lines, Contains(HasSubstr("a bus has one " + only)));
    EXPECT_FALSE(status().contains(only + "-2"));
  }

  // Another process in its place, twice; one that cannot run changes nothing.
  for (int time = 0; time < 2; ++time) {
    const pid_t before = pid_of("relight");
    expect_success({"swap", "relight", "--set", "softness_m=0.3"});
    EXPECT_NE(pid_of("relight"), before);
  }
  EXPECT_THAT(run({"param", "get", "relight", "softness_m"}).lines, Contains("0.3"));
  EXPECT_TRUE(follow("took over as process"));
  const pid_t swapped = pid_of("relight");
  const Answer bad = run({"swap", "relight", "--set", "softness_m=99"});
  EXPECT_EQ(bad.status.code, 1);
  EXPECT_THAT(bad.lines, Contains(AllOf(HasSubstr("from 0 to 10"), HasSubstr("goes on as it was"))));
  const Answer silent = run({"swap", "relight", "--program", "/bin/cat", "--timeout", "0.5"});
  EXPECT_EQ(silent.status.code, 1);
  EXPECT_EQ(pid_of("relight"), swapped);

  // The broker's place is taken in turn, and only by one that accepts its arguments.
  const pid_t broker = pid_of("bus");
  EXPECT_THAT(run({"swap", "bus", "--set", "speed=1"}).lines, Contains(HasSubstr("bus goes on as it was")));
  EXPECT_EQ(pid_of("bus"), broker);
  expect_success({"swap", "bus"});
  EXPECT_NE(pid_of("bus"), broker);
  EXPECT_THAT(run({"swap", "bus", "--program", "/bin/false"}).lines, Contains(HasSubstr("bus goes on as it was")));
  EXPECT_EQ(pid_of("relight"), swapped) << "the others are still there";

  // Stopped stays stopped; what somebody else stops is started again.
  expect_success({"stop", "viewer"});
  EXPECT_EQ(status().at("viewer").at("state"), "stopped");
  ASSERT_GT(swapped, 1);
  kill(swapped, SIGTERM);
  EXPECT_TRUE(eventually([&] {
    const Json now = status().at("relight");
    return now.at("state") == "running" && now.value("pid", 0) != swapped;
  }));
  EXPECT_EQ(status().at("viewer").at("state"), "stopped");
  expect_success({"start", "viewer"});
  EXPECT_EQ(status().at("viewer").at("state"), "running");

  EXPECT_THAT(run({"logs", "relight", "-n", "500"}).lines, Contains(HasSubstr("stopped by signal 15")));
  const Answer mistyped = run({"logs", "relihgt"});
  EXPECT_EQ(mistyped.status.code, 1);
  EXPECT_THAT(mistyped.lines, Contains(HasSubstr("did you mean 'relight'?")));
  std::map<std::string, pid_t> pids;
  for (const auto& [name, process] : status()) pids[name] = process.value("pid", 0);
  const Answer down = run({"down", "--json", "--timeout", "90"});
  ASSERT_TRUE(down.status.success()) << testing::PrintToString(down.lines);
  EXPECT_EQ(down.json().at(0).at("processes").size(), pids.size());
  is_up_ = false;
  for (const auto& [name, pid] : pids) EXPECT_TRUE(pid > 1 && kill(pid, 0) != 0) << name;
  EXPECT_EQ(run({"status"}).status.code, 1);
  EXPECT_TRUE(eventually([&] {
    (void)follower.read_lines(true);
    return follower.poll_exit().has_value();
  })) << "it ends with the supervisor";
  EXPECT_TRUE(follower.poll_exit()->success());
}

/// Every kind of probe, on processes of ours: what comes after starts when it is good.
TEST_F(OperatedPipeline, ReadinessIsAsked) {
  std::uint16_t port = 0;
  {
    LaunchFile file = parse_launch_file("services: [{name: gateway}]", "port.yaml");
    const std::string url = settle_gateway(file, 0)->url;
    port = static_cast<std::uint16_t>(std::stoi(url.substr(url.rfind(':') + 1)));
  }
  const std::string place = "127.0.0.1:" + std::to_string(port);
  ASSERT_NO_FATAL_FAILURE(
      up("services:\n"
         "  - {name: bus, readiness: {command: [test, -S, \"" +
         folder_.path().string() +
         "/slabs\"], period_s: 0.1}}\n"
         "  - {name: gateway, parameters: {http: \"" +
         place +
         "\"},\n"
         "     readiness: {http: \"http://" +
         place +
         "/metrics\", period_s: 0.1}}\n"
         "  - {name: relight, after: [gateway], readiness: {tcp: \"" +
         place + "\", period_s: 0.1}}\n"));
  for (const auto& [name, process] : status()) EXPECT_EQ(process.at("state"), "running") << name;
  // One whose probe is never good holds back what comes after, and is named.
  expect_success({"down"});
  std::ofstream(file()) << "services:\n"
                           "  - name: bus\n"
                           "  - {name: gateway, readiness: {http: \"http://127.0.0.1:1/\", period_s: 0.1}}\n"
                           "  - {name: relight, after: [gateway]}\n";
  const Answer answer = run({"up", "-d", "--timeout", "2", file()});
  EXPECT_EQ(answer.status.code, 1);
  EXPECT_THAT(answer.lines, Contains(AllOf(HasSubstr("gateway is "), HasSubstr("relight is waiting"))));
}

/// A port that somebody else has: said once, and nothing is tried again.
TEST_F(OperatedPipeline, APortInUseIsFinal) {
  const bus::FileDescriptor taken(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t size = sizeof address;
  ASSERT_EQ(::bind(taken.get(), reinterpret_cast<sockaddr*>(&address), size), 0);
  ASSERT_EQ(::listen(taken.get(), 1), 0);
  ASSERT_EQ(::getsockname(taken.get(), reinterpret_cast<sockaddr*>(&address), &size), 0);
  std::ofstream(file()) << "services:\n  - name: bus\n  - {name: gateway, parameters: {http: \"127.0.0.1:"
                        << ntohs(address.sin_port) << "\"}}\n";
  is_up_ = true;
  EXPECT_EQ(run({"up", "-d", file()}).status.code, 1);
  const Json gateway = status().at("gateway");
  EXPECT_EQ(gateway.at("state"), "failed");
  EXPECT_EQ(gateway.at("restarts"), 0);
  EXPECT_THAT(gateway.at("detail").get<std::string>(),
              AllOf(HasSubstr("exited with status 78: "), HasSubstr("Address already in use")));
}

/// A demo's services are operated as any others, on the bus that it prints.
TEST_F(OperatedPipeline, ADemoIsOperatedToo) {
  std::ofstream(file()) << Pipeline::launch_file();
  ChildProcess demo(SPLATBUS_BIN_DIR "/splatbus",
                    {"demo", "--still", "--seconds", "600", "--bus", bus(), "--launch", file(), "--out",
                     (files_.path() / "demo").string()},
                    test_environment());
  ASSERT_TRUE(eventually([&] { return run({"status"}).status.success() && pid_of("relight") != 0; }));
  ASSERT_TRUE(eventually([&] { return status()["relight"].value("state", "") == "running"; }));
  const Answer logs = run({"logs", "relight"});
  EXPECT_TRUE(logs.status.success()) << testing::PrintToString(logs.lines);
  EXPECT_THAT(logs.lines, Contains(HasSubstr("started, process")));
  ChildProcess attached(SPLATBUS_BIN_DIR "/splatbus", {"attach", "--bus", bus()}, test_environment());
  std::vector<std::string> told;
  const pid_t before = pid_of("relight");
  EXPECT_TRUE(eventually([&] {  // it may be attached after the first
    expect_success({"swap", "relight"});
    for (std::string& line : attached.read_lines(false)) told.push_back(std::move(line));
    return std::ranges::any_of(told, [](const auto& line) { return line.find("relight") != std::string::npos; });
  })) << testing::PrintToString(told);
  EXPECT_NE(pid_of("relight"), before);
  expect_success({"down"});
  std::optional<ExitStatus> ended;
  EXPECT_TRUE(eventually([&] { return (ended = demo.poll_exit()).has_value(); }));
  ASSERT_TRUE(ended);
  EXPECT_EQ(ended->code, 1);
  EXPECT_THAT(demo.read_lines(true), Contains(HasSubstr("ended by 'splatbus down'")));
}

}  // namespace
}  // namespace splatbus::cli

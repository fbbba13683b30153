#include <gtest/gtest.h>
#include <poll.h>

#include <chrono>
#include <csignal>
#include <fstream>
#include <string>

#include "../unit/bus/bus_fixture.h"
#include "child_process.h"
#include "command.h"

namespace splatbus::cli {
namespace {

using Clock = std::chrono::steady_clock;

/// Whether a process waits for its signals by itself by now, as every service does from its start on.
bool waits_for_signals(pid_t pid) {
  std::ifstream file("/proc/" + std::to_string(pid) + "/status");
  for (std::string line; std::getline(file, line);) {
    if (!line.starts_with("SigBlk:")) continue;
    const auto blocked = std::stoull(line.substr(7), nullptr, 16);
    return (blocked >> (SIGTERM - 1) & 1U) != 0 && (blocked >> (SIGINT - 1) & 1U) != 0;
  }
  return false;
}

/// Started by hand, before its bus.
class Lone : public testing::TestWithParam<const char*> {};

TEST_P(Lone, AServiceWithoutABusEndsWhenItIsToldTo) {
  // What waits for a broker in one go waits for 10 s.
  constexpr std::chrono::seconds most(7);
  for (const int signal : {SIGTERM, SIGINT}) {
    const bus_test::TemporaryDirectory folder;
    ChildProcess child(SPLATBUS_BIN_DIR + std::string("/splatbus-") + GetParam(),
                       {"--bus", "ipc://" + folder.path() + "/none"}, test_environment());
    pollfd ended{.fd = child.exit_fd(), .events = POLLIN, .revents = 0};
    while (!waits_for_signals(child.pid())) ASSERT_EQ(::poll(&ended, 1, 10), 0) << "it ended by itself";
    const auto begun = Clock::now();
    ASSERT_EQ(::kill(child.pid(), signal), 0);
    ASSERT_EQ(::poll(&ended, 1, 60'000), 1);
    EXPECT_LT(Clock::now() - begun, most);
    const auto status = child.poll_exit();
    ASSERT_TRUE(status);
    EXPECT_EQ(status->text(), "exited with status 0");
  }
}

TEST(LoneService, SaysThatThereIsNoBroker) {
  const bus_test::TemporaryDirectory folder;
  const std::string bus = "ipc://" + folder.path() + "/none";
  ChildProcess child(SPLATBUS_BIN_DIR + std::string("/splatbus-trainer"), {"--bus", bus}, test_environment());
  std::string said;
  while (said.find("no broker answers at " + bus) == std::string::npos) {
    pollfd output{.fd = child.output_fd(), .events = POLLIN, .revents = 0};
    ASSERT_EQ(::poll(&output, 1, 60'000), 1) << said;
    const auto lines = child.read_lines(false);
    ASSERT_FALSE(lines.empty() && (output.revents & POLLHUP) != 0) << said;
    for (const std::string& line : lines) said += line + "\n";
  }
}

INSTANTIATE_TEST_SUITE_P(Services, Lone,
                         testing::Values("capture-bridge", "expander", "trainer", "relight", "streamer"),
                         [](const auto& instance) {
                           std::string name = instance.param;
                           std::erase(name, '-');
                           return name;
                         });

}  // namespace
}  // namespace splatbus::cli

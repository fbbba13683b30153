#include "command.h"

#include <gtest/gtest.h>
#include <poll.h>

#include <optional>

#include "supervised_run.h"

namespace splatbus::cli {

namespace {

constexpr int kPatienceMs = 60000;

}  // namespace

const std::map<std::string, std::string>& test_environment() {
  static const PrivateBusFolder folder;
  static const std::map<std::string, std::string> environment{{"XDG_STATE_HOME", folder.path().string()}};
  return environment;
}

std::vector<nlohmann::json> Answer::json() const {
  std::vector<nlohmann::json> result;
  for (const std::string& line : lines) result.push_back(nlohmann::json::parse(line, nullptr, false));
  return result;
}

Answer splatbus_command(const std::vector<std::string>& arguments, const std::string& program) {
  ChildProcess child(std::string(SPLATBUS_BIN_DIR) + "/" + program, arguments, test_environment());
  Answer answer;
  std::optional<ExitStatus> status;
  while (!status) {
    pollfd events[] = {{.fd = child.output_fd(), .events = POLLIN, .revents = 0},
                       {.fd = child.exit_fd(), .events = POLLIN, .revents = 0}};
    if (poll(events, 2, kPatienceMs) <= 0) break;
    status = child.poll_exit();
    for (std::string& line : child.read_lines(status.has_value())) answer.lines.push_back(std::move(line));
  }
  EXPECT_TRUE(status.has_value()) << program << " " << arguments.front() << " did not end";
  answer.status = status.value_or(ExitStatus{.code = -1, .signal = 0});
  return answer;
}

}  // namespace splatbus::cli

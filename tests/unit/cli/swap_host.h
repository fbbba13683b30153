#pragma once

#include <csignal>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "child_process.h"
#include "swap.h"

namespace splatbus::cli {

/// Has two processes and no policy of its own.
class ChildSwapHost : public SwapHost {
 public:
  ChildSwapHost(pid_t predecessor, std::string program, std::vector<std::string> arguments)
      : predecessor_(predecessor), program_(std::move(program)), arguments_(std::move(arguments)) {}

  [[nodiscard]] pid_t predecessor() const override { return predecessor_; }
  [[nodiscard]] pid_t start_successor() override {
    successor.emplace(program_, arguments_, std::map<std::string, std::string>{});
    return successor->pid();
  }
  [[nodiscard]] std::optional<std::string> successor_end() override {
    for (std::string& line : successor->read_lines(true)) lines.push_back(std::move(line));
    const auto end = successor->poll_exit();
    if (!end) return std::nullopt;
    return lines.empty() ? end->text() : end->text() + ": " + lines.back();
  }
  [[nodiscard]] bool predecessor_ended() override { return ::kill(predecessor_, 0) != 0; }
  void exchange() override { exchanged = true; }
  void drop_successor() override { successor.reset(); }
  void restart_predecessor() override { restarted = true; }

  std::optional<ChildProcess> successor;
  std::vector<std::string> lines;  ///< of its output
  bool exchanged = false, restarted = false;

 private:
  pid_t predecessor_;
  std::string program_;
  std::vector<std::string> arguments_;
};

}  // namespace splatbus::cli

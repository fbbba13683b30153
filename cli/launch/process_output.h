#pragma once

#include <sys/types.h>

#include <functional>
#include <optional>
#include <string>

#include "child_process.h"

namespace splatbus::cli {

/// A line that a process wrote, or something that the supervisor has to say about it.
struct OutputLine {
  std::string process;
  std::string text;   ///< the line, or the event in words
  std::string event;  ///< empty: a line; else started, ready, ended, back-off, failed, stopping, stopped or killed
  pid_t pid = 0;      ///< of an event about one process, else 0
  std::optional<ExitStatus> exit = std::nullopt;      ///< of an end
  std::optional<double> restart_in_s = std::nullopt;  ///< of back-off
};

/// Called by the supervisor's thread.
using Output = std::function<void(const OutputLine&)>;

}  // namespace splatbus::cli

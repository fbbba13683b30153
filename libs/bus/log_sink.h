#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "bus/clock.h"
#include "bus/context.h"

namespace splatbus::bus {

/// Makes spdlog's default logger write to stderr, each line with its time and `name`; under a supervisor, which adds
/// both, with neither. `level` is one of trace, debug, info, warn, error, off. Throws Error on another.
void log_to_stderr(const std::string& name, const std::string& level);

/// The same under the context's name, and to sys/log from level info on.
void install_logger(const std::shared_ptr<Context>& context, const std::string& level);

/// Takes sys/log away again, so that the context can go.
void uninstall_logger();

/// Keeps a flood of bad input from becoming a flood of log lines: one a second.
class LogLimiter {
 public:
  [[nodiscard]] bool allow() {
    const std::int64_t now = now_ns();
    if (last_ns_ != 0 && now - last_ns_ < 1'000'000'000) return false;
    last_ns_ = now;
    return true;
  }

 private:
  std::int64_t last_ns_ = 0;
};

}  // namespace splatbus::bus

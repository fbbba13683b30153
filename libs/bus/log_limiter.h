#pragma once

#include <cstdint>

#include "bus/clock.h"

namespace splatbus::bus {

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

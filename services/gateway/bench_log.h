#pragma once

#include <deque>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>

#include "bus/log_sink.h"

namespace splatbus::gateway {

/// What pages measured of themselves (?bench=1): the last few reports. One thread.
class BenchLog {
 public:
  static constexpr std::size_t kMaxBytes = 16384, kKept = 16;
  static constexpr int kMaxDepth = 8;

  /// Takes a report: one JSON object, nested at most kMaxDepth deep. Empty, or what is wrong with it.
  std::string add(std::string_view text);
  [[nodiscard]] const std::deque<nlohmann::json>& reports() const { return reports_; }

 private:
  std::deque<nlohmann::json> reports_;
  bus::LogLimiter log_limiter_;
};

}  // namespace splatbus::gateway

#pragma once

#include <stop_token>
#include <thread>

namespace splatbus::cli {

/// Turns SIGINT, SIGTERM and SIGHUP into stop requests: the first asks to stop, the second to stop at once. Make one
/// before any other thread starts: threads inherit that these signals are blocked.
class StopSignals {
 public:
  StopSignals();

  [[nodiscard]] std::stop_token stop() const { return stop_.get_token(); }
  [[nodiscard]] std::stop_token kill() const { return kill_.get_token(); }

 private:
  std::stop_source stop_, kill_;
  std::jthread thread_;
};

}  // namespace splatbus::cli

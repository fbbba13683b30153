#pragma once

#include <stop_token>
#include <thread>

namespace splatbus::bus {

/// Turns SIGINT and SIGTERM into a stop request; a second one ends the process at once with status 130. Make it before
/// any other thread: it blocks the signals in the calling thread, and threads inherit that.
class StopSignals {
 public:
  explicit StopSignals(std::stop_source& source);

 private:
  std::jthread thread_;
};

}  // namespace splatbus::bus

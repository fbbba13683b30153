#pragma once

#include <atomic>
#include <thread>

#include "launch_file.h"

namespace splatbus::cli {

/// Asks by a probe, once a period, on a thread of its own, until it is destroyed; an attempt under way is given up
/// then.
class ProbeRunner {
 public:
  explicit ProbeRunner(const Probe& probe);

  /// It was good, at least once. Any thread.
  [[nodiscard]] bool was_good() const { return was_good_; }
  /// It has failed as often in a row as counts. Any thread.
  [[nodiscard]] bool fails() const { return failed_ >= probe_.failures; }

 private:
  void run(const std::stop_token& stop);

  const Probe probe_;
  std::atomic<bool> was_good_ = false;
  std::atomic<int> failed_ = 0;
  std::jthread thread_;
};

}  // namespace splatbus::cli

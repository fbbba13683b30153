#pragma once

#include <chrono>
#include <cstdint>

#include "bus/clock.h"
#include "gl/context.h"

namespace splatbus::viewer {

/// Contexts that are made anew, but not for ever: a device that takes them again and again is not to be drawn with.
class LossLimit {
 public:
  /// Waits until the device is back, and calls `renew`, once more where that loses its context too. Throws what it was
  /// given at the fourth loss in a row, each within ten seconds of the one before; and what else `renew` throws.
  template <class Renew>
  void recover(const ContextLost& lost, const Renew& renew) {
    for (bool done = false; !done;) {
      const std::int64_t now_ns = bus::now_ns();
      in_a_row_ = now_ns - last_ns_ < kSoonNs ? in_a_row_ + 1 : 1;
      last_ns_ = now_ns;
      if (in_a_row_ > kMost) throw lost;
      await_reset(kLongestReset);
      try {
        renew();
        done = true;
      } catch (const ContextLost&) {  // counted above
      }
    }
  }

 private:
  static constexpr std::int64_t kSoonNs = 10'000'000'000;
  static constexpr std::chrono::milliseconds kLongestReset{5000};
  static constexpr int kMost = 3;
  std::int64_t last_ns_ = -kSoonNs;
  int in_a_row_ = 0;
};

}  // namespace splatbus::viewer

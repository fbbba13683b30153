#pragma once

#include <algorithm>
#include <cstdint>
#include <stdexcept>

namespace splatbus::bus {

/// A rate with a burst: tokens come at `rate_per_second` and up to `burst` of them wait. What a token stands for (a
/// message, a byte) is the owner's affair. Full at the first use. Not thread-safe.
class TokenBucket {
 public:
  /// Throws std::invalid_argument when the rate is negative or the burst is not positive. A rate of 0 never refills.
  TokenBucket(double rate_per_second, double burst) : rate_(rate_per_second), burst_(burst), tokens_(burst) {
    if (!(rate_ >= 0) || !(burst_ > 0)) throw std::invalid_argument("a token bucket needs a rate >= 0 and a burst > 0");
  }

  /// Takes `amount` tokens, or none and returns false. `now_ns` is of any monotonic clock, the same at each call; a
  /// time before the latest one brings nothing. More than the burst never fits.
  [[nodiscard]] bool take(double amount, std::int64_t now_ns) {
    refill(now_ns);
    if (!(amount >= 0) || amount > tokens_) return false;
    tokens_ -= amount;
    return true;
  }

  /// What take() would allow at `now_ns`.
  [[nodiscard]] double available(std::int64_t now_ns) {
    refill(now_ns);
    return tokens_;
  }

  /// From `now_ns` on; what waits is kept, up to the new burst.
  void set(double rate_per_second, double burst, std::int64_t now_ns) {
    refill(now_ns);
    const TokenBucket checked(rate_per_second, burst);
    rate_ = checked.rate_;
    burst_ = checked.burst_;
    tokens_ = std::min(tokens_, burst_);
  }

 private:
  void refill(std::int64_t now_ns) {
    if (started_ && now_ns > last_ns_) {
      tokens_ = std::min(burst_, tokens_ + rate_ * (static_cast<double>(now_ns - last_ns_) * 1e-9));
    }
    if (!started_ || now_ns > last_ns_) last_ns_ = now_ns;
    started_ = true;
  }

  double rate_;
  double burst_;
  double tokens_;
  std::int64_t last_ns_ = 0;
  bool started_ = false;
};

}  // namespace splatbus::bus

#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "bus/token_bucket.h"
#include "gateway/parameters.h"

namespace splatbus::gateway {

/// What all connections may say together in a second. While there is plenty each has what it asks for; the less is
/// left, the less may one have said lately who is given more: busy ones wait, and the quiet do not notice. One thread.
class FairBucket {
 public:
  explicit FairBucket(double per_second) : bucket_(per_second, per_second), burst_(per_second) {}

  /// `busy`: how much of its own rate it has used lately, from 0 to 1.
  [[nodiscard]] bool has(double amount, double busy, std::int64_t now_ns) {
    const double whole = std::min(amount, burst_);
    return bucket_.available(now_ns) >= whole + busy * kForTheQuiet * (burst_ - whole);
  }
  void take(double amount, std::int64_t now_ns) {
    (void)bucket_.take(std::min(amount, bucket_.available(now_ns)), now_ns);
  }

 private:
  static constexpr double kForTheQuiet = 0.5;
  bus::TokenBucket bucket_;
  double burst_;
};

/// How much of a rate was used in the last seconds.
class RecentUse {
 public:
  explicit RecentUse(double per_second) : most_(per_second * kSeconds) {}

  void add(double amount, std::int64_t now_ns) {
    sum_ = at(now_ns) + amount;
    since_ns_ = now_ns;
  }
  [[nodiscard]] double share(std::int64_t now_ns) const { return std::min(at(now_ns) / most_, 1.0); }

 private:
  static constexpr double kSeconds = 5;
  [[nodiscard]] double at(std::int64_t now_ns) const {
    return sum_ * std::exp(-static_cast<double>(now_ns - since_ns_) * 1e-9 / kSeconds);
  }

  double most_, sum_ = 0;
  std::int64_t since_ns_ = 0;
};

/// Of all connections. Outlives them.
struct InboundTotal {
  explicit InboundTotal(const Limits& limits)
      : messages(limits.total_messages_per_s), bytes(limits.total_rate_kbps * 125) {}
  FairBucket messages, bytes;
};

/// Of one connection: its own allowance, and its part of that of all. One thread.
class Inbound {
 public:
  Inbound(const Limits& limits, InboundTotal& all)
      : all_(all),
        most_bytes_(limits.rate_kbps * 125),
        messages_(limits.messages_per_s, 2 * limits.messages_per_s),
        bytes_(most_bytes_, most_bytes_),
        recent_messages_(limits.messages_per_s),
        recent_bytes_(most_bytes_) {}

  /// Whether a message that has been read may be dealt with now; otherwise it waits, and with it what comes behind it.
  [[nodiscard]] bool take(std::size_t message_bytes, std::int64_t now_ns) {
    const double bytes = std::min(static_cast<double>(message_bytes), most_bytes_);
    const double busy = std::max(recent_messages_.share(now_ns), recent_bytes_.share(now_ns));
    const bool may = messages_.available(now_ns) >= 1 && bytes_.available(now_ns) >= bytes &&
                     all_.messages.has(1, busy, now_ns) && all_.bytes.has(bytes, busy, now_ns);
    if (!may || !take_control(now_ns) || !bytes_.take(bytes, now_ns)) return false;
    recent_bytes_.add(bytes, now_ns);
    all_.bytes.take(bytes, now_ns);
    return true;
  }
  /// The same of what cannot wait.
  [[nodiscard]] bool take_control(std::int64_t now_ns) {
    if (!messages_.take(1, now_ns)) return false;
    recent_messages_.add(1, now_ns);
    all_.messages.take(1, now_ns);
    return true;
  }

 private:
  InboundTotal& all_;
  double most_bytes_;
  bus::TokenBucket messages_, bytes_;
  RecentUse recent_messages_, recent_bytes_;
};

}  // namespace splatbus::gateway

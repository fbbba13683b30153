#pragma once

#include <algorithm>
#include <cstdint>

#include "bus/token_bucket.h"

namespace splatbus::streamer {

/// Bytes to one viewer: no second has more than 1.1 times the rate.
class ViewerRate {
 public:
  /// kbps 0: found out from what the viewer says that it has received. `most_kbps`: what the viewer wants at most; 0:
  /// it does not mind.
  void set(double kbps, double most_kbps, std::int64_t now_ns);
  /// What is larger than the burst goes when that is there, and is paid for later.
  void take(double bytes, std::int64_t now_ns);
  [[nodiscard]] double available(std::int64_t now_ns);
  [[nodiscard]] double bytes_per_s() const { return bytes_per_s_; }
  [[nodiscard]] double burst() const { return std::max(kBurst_s * bytes_per_s_, kLeastBurst); }

  /// What the viewer said it has received: `bytes`, over `window_s`.
  void acknowledged(double bytes, double window_s, std::int64_t now_ns);

 private:
  static constexpr double kBurst_s = 0.1, kLeastBurst = 8192;
  static constexpr double kLeast = 12500, kFirstAuto = 1.25e6, kLeastAuto = 6e4, kMostAuto = 1.25e8;  // bytes a second
  void use(double bytes_per_s, std::int64_t now_ns);

  bool auto_ = false;
  double kbps_ = -1, most_kbps_ = 0;
  double most_ = kMostAuto, bytes_per_s_ = 0, debt_ = 0, in_flight_ = 0, sent_since_ = 0;
  bus::TokenBucket bucket_{1, 1};
};

}  // namespace splatbus::streamer

#include "streamer/viewer_rate.h"

#include <utility>

namespace splatbus::streamer {

namespace {

constexpr double kQueued_s = 0.5;

}  // namespace

void ViewerRate::use(double bytes_per_s, std::int64_t now_ns) {
  const bool first = bytes_per_s_ == 0;
  bytes_per_s_ = bytes_per_s;
  if (first) bucket_ = bus::TokenBucket(bytes_per_s_, burst());
  bucket_.set(bytes_per_s_, burst(), now_ns);
}

void ViewerRate::set(double kbps, double most_kbps, std::int64_t now_ns) {
  if (kbps == kbps_ && most_kbps == most_kbps_) return;
  const bool same = kbps == kbps_;
  kbps_ = kbps;
  most_kbps_ = most_kbps;
  auto_ = kbps <= 0;
  most_ = most_kbps > 0 ? std::clamp(most_kbps * 125, kLeast, kMostAuto) : kMostAuto;
  const double found = same ? bytes_per_s_ : kFirstAuto;
  use(auto_ ? std::min(found, most_) : most_kbps > 0 ? std::min(kbps * 125, most_) : kbps * 125, now_ns);
}

double ViewerRate::available(std::int64_t now_ns) {
  if (debt_ > 0) {
    const double paid = std::min(debt_, bucket_.available(now_ns));
    if (bucket_.take(paid, now_ns)) debt_ -= paid;
  }
  return debt_ > 0 ? 0 : bucket_.available(now_ns);
}

void ViewerRate::take(double bytes, std::int64_t now_ns) {
  in_flight_ += bytes;
  sent_since_ += bytes;
  const double there = std::min(bytes, bucket_.available(now_ns));
  if (bucket_.take(there, now_ns)) debt_ += bytes - there;
}

// More than half a second's worth on the way: the link takes less. As much as is sent arrives: it may take more.
void ViewerRate::acknowledged(double bytes, double window_s, std::int64_t now_ns) {
  in_flight_ = std::max(0.0, in_flight_ - bytes);
  const double sent = std::exchange(sent_since_, 0);
  if (!auto_ || window_s < 0.01) return;
  const double arrived = bytes / window_s;
  if (in_flight_ > kQueued_s * bytes_per_s_) {
    use(std::clamp(0.9 * std::min(arrived, bytes_per_s_), std::min(kLeastAuto, most_), most_), now_ns);
  } else if (sent > 0.8 * bytes_per_s_ * window_s) {
    use(std::min(1.1 * bytes_per_s_, most_), now_ns);
  }
}

}  // namespace splatbus::streamer

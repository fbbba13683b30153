#pragma once

#include <cstdint>
#include <deque>

namespace splatbus::streamer {

/// How much the last second had: never less than there was, and at most what came in 5 ms before it.
class LastSecond {
 public:
  void add(double amount, std::int64_t now_ns) {
    forget(now_ns);
    sum_ += amount;
    if (!moments_.empty() && now_ns - moments_.back().begin_ns < kMomentNs) {
      moments_.back().amount += amount;
      moments_.back().end_ns = now_ns;
    } else {
      moments_.push_back({now_ns, now_ns, amount});
    }
  }
  [[nodiscard]] double amount(std::int64_t now_ns) {
    forget(now_ns);
    return sum_;
  }

 private:
  static constexpr std::int64_t kSecondNs = 1'000'000'000, kMomentNs = 5'000'000;
  struct Moment {
    std::int64_t begin_ns = 0, end_ns = 0;
    double amount = 0;
  };
  void forget(std::int64_t now_ns) {
    for (; !moments_.empty() && now_ns - moments_.front().end_ns >= kSecondNs; moments_.pop_front()) {
      sum_ -= moments_.front().amount;
    }
    if (moments_.empty()) sum_ = 0;  // what rounding has left
  }

  std::deque<Moment> moments_;
  double sum_ = 0;
};

}  // namespace splatbus::streamer

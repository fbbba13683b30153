#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

namespace splatbus::stream {

/// How long the last scenes took from the engine's frame to the replica, on one machine.
class SceneDelays {
 public:
  static constexpr std::size_t kKept = 1024;

  void add(double milliseconds) {
    if (kept_.size() < kKept) {
      kept_.push_back(milliseconds);
    } else {
      kept_[count_ % kKept] = milliseconds;
    }
    ++count_;
  }

  [[nodiscard]] std::size_t count() const { return count_; }
  /// The delay that `part` of the kept ones do not exceed (nearest rank); 0 while there is none.
  [[nodiscard]] double quantile(double part) const {
    if (kept_.empty()) return 0;
    std::vector<double> sorted = kept_;
    std::sort(sorted.begin(), sorted.end());
    const auto rank = static_cast<std::size_t>(std::ceil(part * static_cast<double>(sorted.size())));
    return sorted[std::clamp<std::size_t>(rank, 1, sorted.size()) - 1];
  }

 private:
  std::vector<double> kept_;
  std::size_t count_ = 0;
};

}  // namespace splatbus::stream

#pragma once

#include <algorithm>
#include <cstdint>
#include <map>
#include <mutex>
#include <tuple>

#include "raster/cuda/device_scene.h"

namespace splatbus::raster::cuda {

/// How many intersections of Gaussians with tiles the next call is likely to have, from calls of the same kind before
/// it. Any thread may use it.
class IsectGuesses {
 public:
  using Kind = std::tuple<int, int, int, int>;  ///< device, cameras, width, height

  [[nodiscard]] std::uint32_t guess(const Kind& kind, std::int64_t gaussians) {
    const std::lock_guard lock(mutex_);
    const auto found = guesses_.find(kind);
    if (found != guesses_.end()) return found->second;
    return bounded(std::max<std::int64_t>(1 << 16, 4 * gaussians * std::get<1>(kind)));
  }

  /// A call had that many. Guesses rise at once and fall slowly, since too low a guess costs a second pass.
  void note(const Kind& kind, std::uint32_t isects) {
    const std::uint32_t wanted = with_room(isects);
    const std::lock_guard lock(mutex_);
    if (guesses_.size() >= kMaxKinds && !guesses_.contains(kind)) guesses_.clear();
    std::uint32_t& guess = guesses_.try_emplace(kind, wanted).first->second;
    guess = wanted > guess ? wanted : guess - (guess - wanted) / 16;
  }

  [[nodiscard]] static std::uint32_t with_room(std::uint32_t isects) {
    return bounded(std::int64_t{isects} + isects / 8 + 1024);
  }

 private:
  static constexpr std::size_t kMaxKinds = 64;
  static std::uint32_t bounded(std::int64_t isects) {
    return static_cast<std::uint32_t>(std::min<std::int64_t>(isects, kMaxIsects));
  }

  std::mutex mutex_;
  std::map<Kind, std::uint32_t> guesses_;
};

}  // namespace splatbus::raster::cuda

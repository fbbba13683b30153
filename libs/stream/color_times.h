#pragma once

#include <cstddef>
#include <cstdint>
#include <iterator>
#include <map>
#include <utility>

#include "stream/replica.h"

namespace splatbus::stream {

/// Which instant of the scene the colours show that a GpuRows gives: that of the scene, where it is another one, or
/// else of the newest visibility, which comes later than the scene that it is of. One thread, the replica's.
class ColorTimes {
 public:
  static constexpr std::size_t kKept = 64;  ///< scene versions

  /// Something has arrived.
  void see(const Replica& replica) {
    if (std::exchange(epoch_, replica.epoch()) != replica.epoch()) captured_ns_.clear();
    const std::int64_t captured_ns = replica.scene_instant().capture_ns;
    if (captured_ns <= 0) return;
    if (!captured_ns_.empty()) {
      // Of another engine, whose clock is another.
      const auto& [version, newest_ns] = *captured_ns_.rbegin();
      if (replica.scene_version() < version || captured_ns < newest_ns) captured_ns_.clear();
    }
    captured_ns_.emplace(replica.scene_version(), captured_ns);
    if (captured_ns_.size() > kKept) captured_ns_.erase(captured_ns_.begin());
  }

  /// Of colours that were taken just now, by the engine's clock; 0: nobody knows. `more`: some of them are still to
  /// come.
  std::int64_t taken(const Replica& replica, bool more) {
    see(replica);
    const bool is_rest = std::exchange(more_, more);
    if (is_rest) return taken_ns_;
    const bool is_new = std::exchange(version_, replica.scene_version()) != replica.scene_version();
    const auto after = captured_ns_.upper_bound(replica.visibility_version());
    const bool sees = !is_new && replica.scene_instant().capture_ns > 0 && after != captured_ns_.begin();
    taken_ns_ = sees ? std::prev(after)->second : replica.scene_instant().capture_ns;
    return taken_ns_;
  }

 private:
  std::map<std::uint64_t, std::int64_t> captured_ns_;  ///< by scene version
  std::uint64_t epoch_ = 0, version_ = 0;
  std::int64_t taken_ns_ = 0;
  bool more_ = false;
};

}  // namespace splatbus::stream

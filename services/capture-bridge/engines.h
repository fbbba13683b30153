#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "capture-bridge/requests.h"
#include "capture-bridge/seniority.h"

namespace splatbus::capture_bridge {

/// The engines that show one world, and which of the cameras each of them renders. The one that leads, the first, says
/// what the scene is, and has what belongs to that frame by frame or is wanted at once: depth maps of lights, depth
/// cubes and probes. Input and reference cameras are divided evenly and stay with their engine while it is in use. One
/// that has been asked for something and brings nothing of use for kPatienceNs rests, and the others have its cameras;
/// each time twice as long: no picture of what it was asked for anew, or after one none for as long and the time
/// between two that its requests' highest rate names. Times are CLOCK_MONOTONIC nanoseconds, of one machine: seniority
/// is. One thread.
class Engines {
 public:
  /// Those of kind "engine" that run, as the broker sees it.
  void take(const wire::Liveness& liveness);
  /// Lets rest who brings nothing, and back who has rested.
  void update(std::int64_t now_ns);

  /// Whether a frame of that source says what the scene is: any source's does while the broker hears no engine.
  [[nodiscard]] bool leads(const std::string& source) const {
    return in_use_.empty() || in_use_.front().name == source;
  }
  /// A picture of use has come from it; what the scene is says nothing of its pictures.
  void brought(const std::string& source, std::int64_t now_ns);

  /// Whether requests go to engines by name: since there have been two of them.
  [[nodiscard]] bool shared() const { return shared_; }
  /// The requests of every engine in use, in their order, and none for one that has had some and is not any more.
  [[nodiscard]] std::map<std::string, std::vector<CameraRequest>> divide(const std::vector<CameraRequest>& requests,
                                                                         std::int64_t now_ns);
  /// True once after the division has become another.
  [[nodiscard]] bool take_changed() { return std::exchange(changed_, false); }
  [[nodiscard]] std::size_t in_use() const { return in_use_.size(); }
  [[nodiscard]] std::size_t resting() const { return running_.size() - in_use_.size(); }

  static constexpr std::int64_t kPatienceNs = 5'000'000'000;
  static constexpr std::int64_t kRestNs = 10'000'000'000, kMostRestNs = 320'000'000'000;

 private:
  struct Conduct {
    /// Since when, for a picture that is due.
    [[nodiscard]] std::optional<std::int64_t> waits_since_ns() const;

    std::optional<std::int64_t> asked_ns;    // anew, and has brought nothing since
    std::optional<std::int64_t> brought_ns;  // last
    float rate_hz = 0;                       // the highest of its requests; 0: each is for one picture
    std::optional<std::int64_t> rests_until_ns;
    std::int64_t next_rest_ns = kRestNs;
    std::uint64_t back_since_ns = 0;  // from its last rest; 0: it has had none
  };
  struct Share {
    std::string engine;
    std::uint64_t request_id = 0;  // that it was last asked by
  };
  using Key = std::pair<CameraRole, std::uint32_t>;
  using Loads = std::map<std::string, std::size_t>;  // cameras, by engine

  void choose();
  [[nodiscard]] bool idles(const Senior& engine, std::int64_t now_ns) const;
  void share_out(const std::vector<CameraRequest>& requests);
  void even_out(std::map<CameraRole, Loads>& loads);

  std::vector<Senior> running_;
  std::vector<Senior> in_use_;  // who has rested goes behind all others
  std::map<std::string, Conduct> conduct_;
  std::map<Key, Share> shares_;
  std::set<std::string> named_;  // who has requests by name
  bool shared_ = false, changed_ = false, uneven_ = false;
};

}  // namespace splatbus::capture_bridge

#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>

#include "gaussians/light.h"

namespace splatbus::capture_bridge {

/// A state of the scene under its number, and the last frame of the engine that leads which showed it.
struct SceneVersion {
  std::shared_ptr<const SceneState> state;  ///< never null
  std::uint64_t frame = 0;
  double time_s = 0;
};

/// The last versions of the scene. A frame of an engine that follows is of the version whose light and objects equal
/// its own, bit for bit, and of none where there is no such version: clocks may differ, and what is equal shows the
/// same. Not compared are the names of depth maps, which each engine counts for itself, and the player's camera, which
/// has no surfaces and is each player's own.
class SceneVersions {
 public:
  /// Numbers are larger than this.
  explicit SceneVersions(std::uint64_t before);

  /// The state has its number already, larger than the newest.
  void add(SceneState state);
  /// The lead's frame shows the newest.
  void seen(std::uint64_t frame, double time_s);
  [[nodiscard]] const SceneVersion& newest() const { return versions_.back(); }
  /// Null where there is none; else good until add().
  [[nodiscard]] const SceneVersion* showing(const SceneState& state) const;

  static constexpr std::size_t kMost = 16;  ///< relight has the depth maps of eight

 private:
  std::deque<SceneVersion> versions_;  // by ascending number
  bool any_ = false;                   // before, the only one is of nothing that an engine has shown
};

}  // namespace splatbus::capture_bridge

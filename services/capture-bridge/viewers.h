#pragma once

#include <cstdint>
#include <glm/glm.hpp>
#include <map>
#include <string>
#include <vector>

#include "gaussians/camera.h"
#include "wire/viewer_poses.h"

namespace splatbus::capture_bridge {

/// A viewer as the rigs follow it.
struct Viewer {
  Camera camera;
  glm::vec3 velocity_m_s{0};
  glm::vec3 turn_radians_s{0};  ///< about this axis of the world, by its length
  std::uint64_t jumps = 0;      ///< poses so far that were farther from the one before than anybody walks
  std::uint64_t arrival = 0;    ///< whoever came earlier has a smaller one
  std::int64_t posed_ns = 0;    ///< CLOCK_MONOTONIC

  [[nodiscard]] const glm::vec3& position() const { return camera.world_from_camera.translation; }
  /// Unit, world.
  [[nodiscard]] glm::vec3 forward() const { return camera.world_from_camera.rotation * glm::vec3(0, 0, 1); }
  /// Angle about world y, radians, 0 looking along -z. Keeps `fallback` where the viewer looks straight up or down.
  [[nodiscard]] float heading(float fallback = 0) const;
  /// Where he will look from, as he moves and turns now.
  [[nodiscard]] Rigid pose_in(float seconds) const;
};

/// The viewers by name. Those that have left are forgotten while others are there; when nobody is, the last ones stay
/// where they were: a viewer that pauses finds everything as it was. Not thread-safe.
class Viewers {
 public:
  /// `jump_m`: a step between two poses that is no walk.
  void update(const ViewerPoses& poses, float jump_m, std::int64_t now_ns);

  [[nodiscard]] const std::map<std::string, Viewer>& all() const { return viewers_; }
  [[nodiscard]] bool empty() const { return viewers_.empty(); }
  /// By arrival.
  [[nodiscard]] std::vector<std::string> in_order() const;
  /// Where the first one is, or, among those within `about_m` of it, the middle. There is one.
  [[nodiscard]] glm::vec3 middle(float about_m) const;

 private:
  std::map<std::string, Viewer> viewers_;
  std::uint64_t arrivals_ = 0;
};

}  // namespace splatbus::capture_bridge

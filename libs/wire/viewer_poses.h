#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <map>
#include <string>

#include "gaussians/camera.h"
#include "wire/convert.h"
#include "wire/viewer_generated.h"

namespace splatbus {

/// Who looks from where: the newest pose of each viewer that has told one lately, by the viewer's name. Not
/// thread-safe.
class ViewerPoses {
 public:
  static constexpr std::int64_t kSilenceNs = 2'000'000'000;  ///< then a viewer has left
  static constexpr std::size_t kMaxViewers = 256;            ///< further ones are not followed

  struct Pose {
    Camera camera;
    std::int64_t seen_ns = 0;
  };

  static constexpr float kFarthest_m = 1e6F;     ///< a pose beyond is no viewer's
  static constexpr float kMostFocalSides = 100;  ///< nor one with a longer focal length, in sides of its picture

  /// False where there is no room for one more viewer, or the pose is none that one can have.
  bool take(const wire::ViewerPose& pose, std::int64_t now_ns) {
    const std::string viewer = pose.viewer()->str();
    const Camera camera = from_wire(*pose.camera());
    const glm::vec3 at = glm::abs(camera.world_from_camera.translation);
    const auto side = static_cast<float>(std::max(camera.width, camera.height));
    if (std::max({at.x, at.y, at.z}) > kFarthest_m) return false;
    if (std::max(camera.fx, camera.fy) > kMostFocalSides * side) return false;
    if (!poses_.contains(viewer) && poses_.size() >= kMaxViewers) return false;
    poses_.insert_or_assign(viewer, Pose{camera, now_ns});
    return true;
  }

  /// Forgets who has been silent. Returns whether anybody was.
  bool expire(std::int64_t now_ns) {
    return std::erase_if(poses_, [&](const auto& entry) { return now_ns - entry.second.seen_ns >= kSilenceNs; }) > 0;
  }

  [[nodiscard]] const std::map<std::string, Pose>& all() const { return poses_; }
  [[nodiscard]] bool empty() const { return poses_.empty(); }

 private:
  std::map<std::string, Pose> poses_;
};

}  // namespace splatbus

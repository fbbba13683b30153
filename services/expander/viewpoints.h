#pragma once

#include <cstdint>
#include <map>
#include <span>
#include <string>
#include <vector>

#include "expander/insertion.h"
#include "gaussians/camera.h"
#include "wire/viewer_poses.h"

namespace splatbus::expander {

/// Who looks from where, and where he goes. Not thread-safe.
class Viewpoints {
 public:
  /// `published_ns`: of the pose, by its sender's clock; `now_ns` by ours.
  void take(const wire::ViewerPose& pose, std::int64_t published_ns, std::int64_t now_ns);

  /// Of the viewers that have told a pose lately; without any, of the cameras, which stand still.
  [[nodiscard]] std::vector<Viewpoint> at(std::int64_t now_ns, double ahead_s, std::span<const Camera> cameras);

 private:
  struct Motion {
    glm::vec3 position{0}, velocity_m_per_s{0};
    std::int64_t published_ns = 0;
  };
  ViewerPoses poses_;
  std::map<std::string, Motion> motions_;  // of the same viewers
};

}  // namespace splatbus::expander

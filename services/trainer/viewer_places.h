#pragma once

#include <cstdint>
#include <map>
#include <mutex>
#include <string>
#include <vector>

#include "math/portable.h"
#include "wire/viewer_poses.h"

namespace splatbus::trainer {

/// Where viewers are, and where they will be in two seconds if they go on as they do. Thread-safe.
class ViewerPlaces {
 public:
  void take(const wire::ViewerPose& pose, std::int64_t now_ns) {
    const std::scoped_lock lock(mutex_);
    poses_.expire(now_ns);
    std::erase_if(speeds_, [&](const auto& entry) { return !poses_.all().contains(entry.first); });
    const std::string viewer = pose.viewer()->str();
    const auto before = poses_.all().find(viewer);
    const bool known = before != poses_.all().end();
    const ViewerPoses::Pose old = known ? before->second : ViewerPoses::Pose{};
    if (!poses_.take(pose, now_ns) || !known || now_ns - old.seen_ns < kLeastInterval_ns) return;
    const glm::vec3 way = position(poses_.all().at(viewer)) - position(old);
    speeds_[viewer] = way / (static_cast<float>(now_ns - old.seen_ns) * 1e-9F);
  }

  [[nodiscard]] std::vector<math::Vec3> places(std::int64_t now_ns) {
    const std::scoped_lock lock(mutex_);
    poses_.expire(now_ns);
    std::vector<math::Vec3> places;
    for (const auto& [viewer, pose] : poses_.all()) {
      const glm::vec3 here = position(pose);
      places.push_back({here.x, here.y, here.z});
      const auto speed = speeds_.find(viewer);
      if (speed == speeds_.end()) continue;
      const glm::vec3 soon = here + kAhead_s * speed->second;
      places.push_back({soon.x, soon.y, soon.z});
    }
    return places;
  }

 private:
  static constexpr float kAhead_s = 2;
  /// Poses that were waiting come in one burst, and say nothing of speed.
  static constexpr std::int64_t kLeastInterval_ns = 5'000'000;
  static glm::vec3 position(const ViewerPoses::Pose& pose) { return pose.camera.world_from_camera.translation; }

  std::mutex mutex_;
  ViewerPoses poses_;
  std::map<std::string, glm::vec3> speeds_;  ///< m/s
};

}  // namespace splatbus::trainer

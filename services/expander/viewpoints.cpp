#include "expander/viewpoints.h"

#include "gaussians/portable.h"

namespace splatbus::expander {

namespace {

constexpr float kMaxSpeed_m_per_s = 40;  // faster is a jump, which says nothing of what comes
constexpr double kSmoothing_s = 0.25;    // of a velocity: a step or a turn of the head is no change of way
constexpr double kLongestStep_s = 1;     // between poses that tell a velocity

}  // namespace

void Viewpoints::take(const wire::ViewerPose& pose, std::int64_t published_ns, std::int64_t now_ns) {
  if (!poses_.take(pose, now_ns)) return;
  const glm::vec3 position = from_wire(*pose.camera()).world_from_camera.translation;
  Motion& motion = motions_[pose.viewer()->str()];
  const double step_s = static_cast<double>(published_ns - motion.published_ns) * 1e-9;
  if (step_s <= 0) return;
  const glm::vec3 velocity = (position - motion.position) / static_cast<float>(step_s);
  if (step_s > kLongestStep_s || !(glm::length(velocity) <= kMaxSpeed_m_per_s)) {
    motion.velocity_m_per_s = glm::vec3(0);
  } else {
    const auto share = static_cast<float>(step_s / (step_s + kSmoothing_s));
    motion.velocity_m_per_s += share * (velocity - motion.velocity_m_per_s);
  }
  motion.position = position;
  motion.published_ns = published_ns;
}

std::vector<Viewpoint> Viewpoints::at(std::int64_t now_ns, double ahead_s, std::span<const Camera> cameras) {
  if (poses_.expire(now_ns)) {
    std::erase_if(motions_, [&](const auto& entry) { return !poses_.all().contains(entry.first); });
  }
  std::vector<Viewpoint> viewpoints;
  for (const auto& [viewer, pose] : poses_.all()) {
    const glm::vec3 position = pose.camera.world_from_camera.translation;
    const glm::vec3 ahead = position + static_cast<float>(ahead_s) * motions_[viewer].velocity_m_per_s;
    viewpoints.push_back({portable(position), portable(ahead), pose.camera.fx});
  }
  if (!viewpoints.empty()) return viewpoints;
  for (const Camera& camera : cameras) {
    const math::Vec3 position = portable(camera.world_from_camera.translation);
    viewpoints.push_back({position, position, camera.fx});
  }
  return viewpoints;
}

}  // namespace splatbus::expander

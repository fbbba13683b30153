#include "capture-bridge/viewers.h"

#include <algorithm>
#include <cmath>
#include <glm/gtc/constants.hpp>
#include <glm/gtc/quaternion.hpp>

namespace splatbus::capture_bridge {

namespace {

constexpr double kSmoothing_s = 0.3;                 // of velocities
constexpr double kTurnSmoothing_s = 0.1;             // a turn is over before long
constexpr float kMostTurn = glm::pi<float>() / 2;    // that is looked ahead for
constexpr std::int64_t kRestsAfterNs = 500'000'000;  // a viewer that moves tells its pose more often

glm::vec3 rotation_vector(glm::quat turn) {
  if (turn.w < 0) turn = -turn;
  const float sine = glm::length(glm::vec3(turn.x, turn.y, turn.z));
  if (sine < 1e-6F) return glm::vec3(0);
  return glm::vec3(turn.x, turn.y, turn.z) * (2 * std::atan2(sine, turn.w) / sine);
}

void follow(Viewer& viewer, const ViewerPoses::Pose& pose, float jump_m) {
  if (pose.seen_ns == viewer.posed_ns) return;
  const glm::vec3 step = pose.camera.world_from_camera.translation - viewer.position();
  const double seconds = static_cast<double>(pose.seen_ns - viewer.posed_ns) * 1e-9;
  if (glm::length(step) > jump_m) {
    ++viewer.jumps;
    viewer.velocity_m_s = viewer.turn_radians_s = glm::vec3(0);
  } else {
    const auto share = [seconds](double over_s) { return static_cast<float>(1 - std::exp(-seconds / over_s)); };
    const auto rate = [seconds](const glm::vec3& change) { return change / static_cast<float>(seconds); };
    const glm::quat before = viewer.camera.world_from_camera.rotation;
    const glm::vec3 turn = rotation_vector(pose.camera.world_from_camera.rotation * glm::inverse(before));
    viewer.velocity_m_s = glm::mix(viewer.velocity_m_s, rate(step), share(kSmoothing_s));
    viewer.turn_radians_s = glm::mix(viewer.turn_radians_s, rate(turn), share(kTurnSmoothing_s));
  }
  viewer.camera = pose.camera;
  viewer.posed_ns = pose.seen_ns;
}

}  // namespace

float Viewer::heading(float fallback) const {
  const glm::vec3 ahead = forward();
  if (glm::length(glm::vec2(ahead.x, ahead.z)) < 0.05F) return fallback;
  return std::atan2(-ahead.x, -ahead.z);
}

Rigid Viewer::pose_in(float seconds) const {
  Rigid pose = camera.world_from_camera;
  pose.translation += seconds * velocity_m_s;
  const float rate = glm::length(turn_radians_s);
  if (rate > 0) {
    const float angle = std::min(kMostTurn, seconds * rate);
    pose.rotation = glm::normalize(glm::angleAxis(angle, turn_radians_s / rate) * pose.rotation);
  }
  return pose;
}

void Viewers::update(const ViewerPoses& poses, float jump_m, std::int64_t now_ns) {
  if (!poses.empty()) {
    std::erase_if(viewers_, [&](const auto& entry) { return !poses.all().contains(entry.first); });
  }
  for (const auto& [name, pose] : poses.all()) {
    const auto [place, is_new] = viewers_.try_emplace(name);
    if (is_new) {
      place->second = {.camera = pose.camera, .arrival = ++arrivals_, .posed_ns = pose.seen_ns};
    } else {
      follow(place->second, pose, jump_m);
    }
  }
  for (auto& [name, viewer] : viewers_) {
    if (now_ns - viewer.posed_ns > kRestsAfterNs) viewer.velocity_m_s = viewer.turn_radians_s = glm::vec3(0);
  }
}

std::vector<std::string> Viewers::in_order() const {
  std::vector<std::string> names;
  for (const auto& [name, viewer] : viewers_) names.push_back(name);
  std::ranges::sort(names, {}, [&](const std::string& name) { return viewers_.at(name).arrival; });
  return names;
}

glm::vec3 Viewers::middle(float about_m) const {
  const auto first = std::ranges::min_element(viewers_, {}, [](const auto& entry) { return entry.second.arrival; });
  glm::vec3 sum(0);
  float count = 0;
  for (const auto& [name, viewer] : viewers_) {
    if (glm::distance(viewer.position(), first->second.position()) > about_m) continue;
    sum += viewer.position();
    ++count;
  }
  return sum / count;
}

}  // namespace splatbus::capture_bridge

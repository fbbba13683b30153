#include "streamer/page_weights.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace splatbus::streamer {

namespace {

constexpr float kOutside = 0.1F;
constexpr float kCentimetres2 = 1e4F;
constexpr float kAhead_s = 0.5F;
constexpr std::int64_t kStaleNs = 1'000'000'000;  // older poses say nothing of a velocity
constexpr float kLeast = 1e-3F;                   // px: whatever is there comes at last

struct Sphere {
  glm::vec3 centre;
  float radius;
};

float area_px2(const Camera& camera, const Sphere& sphere) {
  const glm::vec3 p = inverse(camera.world_from_camera) * sphere.centre;
  const float picture = static_cast<float>(camera.width) * static_cast<float>(camera.height);
  const float depth = std::max(p.z, camera.near_m);
  const float radius_px = sphere.radius * std::max(camera.fx, camera.fy) / depth;
  const float area = std::clamp(std::numbers::pi_v<float> * radius_px * radius_px, kLeast, picture);
  if (glm::length(p) <= sphere.radius) return picture;
  const float x = camera.fx * p.x / depth + camera.cx, y = camera.fy * p.y / depth + camera.cy;
  const bool inside = p.z > -sphere.radius && x > -radius_px && y > -radius_px &&
                      x < static_cast<float>(camera.width) + radius_px &&
                      y < static_cast<float>(camera.height) + radius_px;
  if (inside) return area;
  // What lies behind comes into view by turning: as large as at its distance.
  const float away = std::max(glm::length(p), camera.near_m);
  const float turned = sphere.radius * std::max(camera.fx, camera.fy) / away;
  return kOutside * std::clamp(std::numbers::pi_v<float> * turned * turned, kLeast, picture);
}

}  // namespace

void GazeTracker::add(const Camera& camera, std::int64_t now_ns) {
  Camera soon = camera;
  const auto since_s = static_cast<float>(now_ns - pose_ns_) * 1e-9F;
  if (gaze_ && since_s > 0 && now_ns - pose_ns_ < kStaleNs) {
    const Rigid& before = gaze_->now.world_from_camera;
    Rigid& ahead = soon.world_from_camera;
    ahead.translation += (ahead.translation - before.translation) * (kAhead_s / since_s);
    const glm::quat turn = ahead.rotation * glm::conjugate(before.rotation);
    const float angle = std::clamp(glm::angle(turn) * (kAhead_s / since_s), 0.0F, 1.0F);
    if (glm::angle(turn) > 1e-4F) ahead.rotation = glm::angleAxis(angle, glm::axis(turn)) * ahead.rotation;
  }
  gaze_ = {camera, soon};
  pose_ns_ = now_ns;
}

float page_weight(const stream::OfferedPage& page, const std::optional<ViewerGaze>& gaze,
                  const ObjectTransforms& objects) {
  const math::Vec3 &low = page.bounds.low, &high = page.bounds.high;
  if (!(low.x <= high.x)) return kLeast;
  const glm::vec3 a(low.x, low.y, low.z), b(high.x, high.y, high.z);
  Sphere sphere{0.5F * (a + b), 0.5F * glm::length(b - a) + page.bounds.max_scale_m};
  float shown = 1;
  if (page.object_id == kFarFieldFrame) {
    // It goes with whoever looks, and is behind all else.
    return gaze ? static_cast<float>(gaze->now.width) * static_cast<float>(gaze->now.height) * 0.5F : kCentimetres2;
  }
  if (page.object_id != kWorldFrame) {
    if (const auto object = objects.find(page.object_id); object != objects.end()) {
      sphere = {object->second * sphere.centre, sphere.radius * object->second.scale};
    } else {
      shown = kOutside;
    }
  }
  if (!gaze) return shown * std::max(sphere.radius * sphere.radius * kCentimetres2, kLeast);
  return shown * std::max(area_px2(gaze->now, sphere), area_px2(gaze->soon, sphere));
}

}  // namespace splatbus::streamer

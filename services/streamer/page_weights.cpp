#include "streamer/page_weights.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "gaussians/page_area.h"

namespace splatbus::streamer {

namespace {

constexpr float kOutside = 0.1F;
constexpr float kCentimetres2 = 1e4F;
constexpr float kAhead_s = 0.5F;
constexpr std::int64_t kStaleNs = 1'000'000'000;  // older poses say nothing of a velocity
constexpr float kLeast = 1e-3F;                   // px: whatever is there comes at last
// Of a page's area that it makes up: of one that no picture was taken of, and of one that was hidden in all of them,
// which a viewer may see from where none was taken.
constexpr float kUsuallyShown = 0.3F, kLeastShown = 0.02F;

float area_px2(const Camera& camera, const BoundingSphere& sphere) {
  if (const auto area = picture_area_px2(camera, sphere)) return std::max(*area, kLeast);
  // What lies behind comes into view by turning: as large as at its distance.
  const glm::vec3 p = inverse(camera.world_from_camera) * sphere.centre;
  const float away = std::max(glm::length(p), camera.near_m);
  const float turned = sphere.radius * std::max(camera.fx, camera.fy) / away;
  const float picture = static_cast<float>(camera.width) * static_cast<float>(camera.height);
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
  const PageBounds& bounds = page.bounds;
  if (!(bounds.low.x <= bounds.high.x)) return kLeast;
  if (page.object_id == kFarFieldFrame) {
    // It goes with whoever looks, and is behind all else.
    return gaze ? static_cast<float>(gaze->now.width) * static_cast<float>(gaze->now.height) * 0.5F : kCentimetres2;
  }
  auto sphere = bounding_sphere(bounds, page.object_id, objects);
  float shown = page.shown_share > 0 ? std::max(page.shown_share, kLeastShown) : kUsuallyShown;
  if (!sphere) {
    shown *= kOutside;
    sphere = bounding_sphere(bounds, kWorldFrame, objects);
  }
  if (!gaze) return shown * std::max(sphere->radius * sphere->radius * kCentimetres2, kLeast);
  return shown * std::max(area_px2(gaze->now, *sphere), area_px2(gaze->soon, *sphere));
}

}  // namespace splatbus::streamer

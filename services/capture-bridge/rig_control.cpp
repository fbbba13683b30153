#include "capture-bridge/rig_control.h"

#include <algorithm>
#include <cmath>
#include <glm/trigonometric.hpp>
#include <utility>

namespace splatbus::capture_bridge {

namespace {

using wire::EngineBuffer;

}  // namespace

std::vector<Camera> RigControl::update(const Camera* viewer, const ContentHeights& content, bool hold_input) {
  std::vector<Camera> left;
  const bool changed = options_.refresh() || !placed_;
  placed_ = true;
  std::optional<ViewerState> state;
  if (viewer != nullptr) state = ViewerState::of(*viewer);
  if (changed || !hold_input) {
    const bool moved = tracker_.update(options_->tracker, state ? &*state : nullptr, content);
    if (changed || moved) place_inputs(left);
  }
  const bool follow = options_->follow && viewer != nullptr;
  const bool asks_anew = std::exchange(asks_for_ids_, wants_ids_) != wants_ids_;
  if (changed || asks_anew || (follow && viewer_moved(*viewer))) place_references(follow ? viewer : nullptr, left);
  return left;
}

void RigControl::place_inputs(std::vector<Camera>& left) {
  std::vector<Camera> cameras = dome_cameras(options_->dome, tracker_.pose().centre, tracker_.pose().heading_radians);
  for (Camera& camera : cameras) {
    camera.near_m = options_->near_m;
    camera.far_m = options_->far_m;
  }
  const auto before = cameras_.of_role(CameraRole::Input);
  const auto gone = cameras_.replace(CameraRole::Input, cameras,
                                     EngineBuffer::Color | EngineBuffer::Albedo | EngineBuffer::WorldPosition |
                                         EngineBuffer::Normal | EngineBuffer::ObjectId,
                                     options_->input_rate_hz);
  left.insert(left.end(), gone.begin(), gone.end());
  const auto now = cameras_.of_role(CameraRole::Input);
  const bool same = std::equal(before.begin(), before.end(), now.begin(), now.end(),
                               [](const auto& a, const auto& b) { return a.request_id == b.request_id; });
  if (!same || round_.rig_generation() == 0) round_.begin(now);
}

void RigControl::place_references(const Camera* viewer, std::vector<Camera>& left) {
  followed_ = viewer != nullptr ? std::optional(*viewer) : std::nullopt;
  std::vector<Camera> cameras =
      viewer != nullptr ? follow_cameras(options_->follow_rig, *viewer) : ring_cameras(options_->ring);
  for (Camera& camera : cameras) {
    camera.near_m = options_->near_m;
    camera.far_m = options_->far_m;
  }
  EngineBuffer buffers = EngineBuffer::Color | EngineBuffer::Albedo;
  if (options_->reference_depth) buffers |= EngineBuffer::Depth;
  if (asks_for_ids_) buffers |= EngineBuffer::ObjectId;
  const auto gone = cameras_.replace(CameraRole::Reference, cameras, buffers, options_->reference_rate_hz);
  left.insert(left.end(), gone.begin(), gone.end());
}

void RigControl::update_lights(const Light& light) {
  cameras_.replace(CameraRole::Light, lights_.requests(options_->light, light, tracker_.pose().centre));
}

bool RigControl::viewer_moved(const Camera& viewer) const {
  if (!followed_) return true;
  const Rigid& a = followed_->world_from_camera;
  const Rigid& b = viewer.world_from_camera;
  const float turned = 2 * std::acos(std::min(1.0F, std::abs(glm::dot(a.rotation, b.rotation))));
  return glm::distance(a.translation, b.translation) > options_->follow_move_m ||
         turned > options_->follow_turn_radians;
}

void RigControl::reissue_missing_inputs() {
  cameras_.reissue(CameraRole::Input, round_.missing());
  round_.renew(cameras_.of_role(CameraRole::Input));
}

void RigControl::reissue(CameraRole role, std::uint32_t camera_id) {
  cameras_.reissue(role, std::span(&camera_id, 1));
  if (role == CameraRole::Input) round_.renew(cameras_.of_role(CameraRole::Input));
}

void RigControl::reissue_missing_lights() {
  cameras_.reissue(CameraRole::Light, lights_.missing());
}

void RigControl::reissue_inputs() {
  cameras_.reissue_all(CameraRole::Input);
  round_.renew(cameras_.of_role(CameraRole::Input));
}

}  // namespace splatbus::capture_bridge

#include "capture-bridge/rig_control.h"

#include <utility>

namespace splatbus::capture_bridge {

using wire::EngineBuffer;

std::vector<Camera> RigControl::update(const ViewerPoses& poses, std::int64_t now_ns) {
  const bool first = !std::exchange(placed_, true);
  const bool anew = options_.refresh() || first;
  viewers_.update(poses, options_->dome.radius_m, now_ns);
  RangeOptions range = options_->range;
  if (options_->placement.fixed_centre && !options_->follow) range.rate_hz = 0;
  ranges_.update(range, viewers_, now_ns, cameras_);
  std::vector<Camera> left = inputs_.update(*options_, anew, viewers_, ranges_, now_ns, cameras_);
  const bool asks_anew = std::exchange(asks_for_ids_, wants_ids_) != wants_ids_;
  const auto gone =
      references_.update(*options_, anew || asks_anew, reference_buffers(), viewers_, ranges_, now_ns, cameras_);
  left.insert(left.end(), gone.begin(), gone.end());
  return left;
}

EngineBuffer RigControl::reference_buffers() const {
  EngineBuffer buffers = EngineBuffer::Color | EngineBuffer::Albedo;
  if (options_->reference_depth) buffers |= EngineBuffer::Depth;
  if (asks_for_ids_) buffers |= EngineBuffer::ObjectId;
  return buffers;
}

void RigControl::update_lights(const Light& light) {
  const bool fixed = viewers_.empty() || options_->placement.fixed_centre;
  const glm::vec3 centre = fixed ? options_->placement.centre : viewers_.middle(options_->light.extent_m);
  cameras_.replace(CameraRole::Light, lights_.requests(options_->light, light, centre));
}

void RigControl::reissue(CameraRole role, std::uint32_t camera_id) {
  if (role == CameraRole::Input) return inputs_.reissue(camera_id, cameras_);
  cameras_.reissue(role, std::span(&camera_id, 1));
}

void RigControl::reissue_missing_lights() {
  cameras_.reissue(CameraRole::Light, lights_.missing());
}

}  // namespace splatbus::capture_bridge

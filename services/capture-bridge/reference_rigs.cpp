#include "capture-bridge/reference_rigs.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace splatbus::capture_bridge {

namespace {

constexpr std::int64_t kPatienceNs = 500'000'000;  // then a picture that has not come is not waited for

bool same_picture(const Camera& a, const Camera& b) {
  return a.width == b.width && a.height == b.height && a.fx == b.fx && a.fy == b.fy;
}

bool stands_off(const Options& options, const Rigid& a, const Rigid& b) {
  const float turned = 2 * std::acos(std::min(1.0F, std::abs(glm::dot(a.rotation, b.rotation))));
  return glm::distance(a.translation, b.translation) > options.follow_move_m || turned > options.follow_turn_radians;
}

}  // namespace

std::vector<Camera> ReferenceRigs::update(const Options& options, bool anew, wire::EngineBuffer buffers,
                                          const Viewers& viewers, const RangeFinder& ranges, std::int64_t now_ns,
                                          CameraSet& cameras) {
  const bool follows = options.follow && !viewers.empty();
  bool changed = std::exchange(follows_, follows) != follows || anew;
  std::vector<Camera> stands;
  if (follows) {
    std::map<std::uint32_t, Standing> standing;
    for (const Camera& camera : wanted(options, viewers, ranges)) {
      const auto known = standing_.find(camera.id);
      const Standing one = known == standing_.end() ? Standing{} : known->second;
      const bool waits = one.pending && now_ns - one.asked_ns < kPatienceNs;
      const glm::vec3 way = camera.world_from_camera.translation - one.camera.world_from_camera.translation;
      const bool hurries = waits && !one.hurried && glm::length(way) > options.dome.radius_m;
      const bool moves = known == standing_.end() || anew || !same_picture(one.camera, camera) || hurries ||
                         (!waits && stands_off(options, one.camera.world_from_camera, camera.world_from_camera));
      standing[camera.id] =
          moves ? Standing{.camera = camera, .pending = true, .asked_ns = now_ns, .hurried = hurries} : one;
      changed = changed || moves;
    }
    changed = changed || standing.size() != standing_.size();
    standing_ = std::move(standing);
    for (const auto& [id, one] : standing_) stands.push_back(one.camera);
  } else {
    standing_.clear();
    if (changed) stands = ring_cameras(options.ring);
  }
  if (!changed) return {};
  for (Camera& camera : stands) {
    camera.near_m = options.near_m;
    camera.far_m = options.far_m;
  }
  return cameras.replace(CameraRole::Reference, stands, buffers, options.reference_rate_hz);
}

std::vector<Camera> ReferenceRigs::wanted(const Options& options, const Viewers& viewers, const RangeFinder& ranges) {
  const std::vector<std::string> names = viewers.in_order();
  const int total = options.follow_rig.cameras;
  shares_.set_total(total);
  const std::vector<int> divided = divide_cameras(total, std::vector<float>(names.size(), 1), 1);
  CameraShares::Shares shares;
  for (std::size_t i = 0; i < names.size(); ++i) shares[names[i]] = divided[i];
  std::vector<std::string> left;
  for (const auto& [owner, ids] : shares_.all()) {
    if (!shares.contains(owner)) left.push_back(owner);
  }
  for (const std::string& owner : left) shares_.release(owner);
  std::vector<Camera> cameras;
  for (const std::string& name : names) {
    shares_.take_share(name, shares);
    const Viewer& viewer = viewers.all().at(name);
    const FreeSpace* const free = ranges.about(name, viewer.position());
    FollowOptions rig = options.follow_rig;
    const auto ids = shares_.of(name);
    rig.cameras = static_cast<int>(ids.size());
    for (Camera& camera : follow_cameras(rig, viewer.camera)) {
      glm::vec3& eye = camera.world_from_camera.translation;
      // The aligned one is where the viewer is, whatever that may be.
      if (camera.id > 0 && free != nullptr) eye = free->reachable(eye, options.clearance_m);
      camera.id = ids[camera.id];
      cameras.push_back(camera);
    }
  }
  return cameras;
}

void ReferenceRigs::arrived(std::uint32_t camera_id) {
  if (const auto found = standing_.find(camera_id); found != standing_.end()) found->second.pending = false;
}

}  // namespace splatbus::capture_bridge

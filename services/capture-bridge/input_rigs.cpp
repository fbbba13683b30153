#include "capture-bridge/input_rigs.h"

#include <algorithm>
#include <cmath>
#include <glm/gtc/constants.hpp>
#include <numeric>
#include <utility>

#include "capture-bridge/nanoseconds.h"

namespace splatbus::capture_bridge {

namespace {

using wire::EngineBuffer;

constexpr int kLeastCameras = 4;                 // a round by fewer shows too little
constexpr std::size_t kCamerasForEachAbout = 4;  // besides the eye
constexpr int kMaxBlind = 3;                     // pictures of a camera, before it is given up
constexpr float kEyeMove_m = 0.25F;              // beyond which the eye looks anew
constexpr float kEyeTurn = 0.9659258F;           // cosine of 15 degrees
constexpr std::int64_t kEyePeriodNs = 200'000'000;
constexpr std::int64_t kRangePatienceNs = 300'000'000;  // then a dome stands untested

float turned(const DomePlace& a, const DomePlace& b) {
  return std::abs(std::remainder(a.heading_radians - b.heading_radians, glm::two_pi<float>()));
}

/// The dome's places in the order of the cameras that are kept longest, by the bits of their numbers in reverse: the
/// first few are spread over all of the dome, whatever their number.
std::vector<std::size_t> spread_places(std::size_t count) {
  std::vector<std::size_t> places(count);
  std::iota(places.begin(), places.end(), std::size_t{0});
  const auto reversed = [](std::size_t place) {
    std::uint32_t bits = 0;
    for (int bit = 0; bit < 16; ++bit) bits = bits << 1U | (place >> bit & 1U);
    return bits;
  };
  std::ranges::sort(places, {}, reversed);
  return places;
}

}  // namespace

std::vector<Camera> InputRigs::update(const Options& options, bool anew, const Viewers& viewers,
                                      const RangeFinder& ranges, std::int64_t now_ns, CameraSet& cameras) {
  shares_.set_total(options.dome.cameras);
  std::vector<Wish> wished = wishes(options, viewers, ranges);
  std::vector<float> needs;
  needs.reserve(wished.size());
  for (const Wish& wish : wished) needs.push_back(wish.need);
  const std::vector<int> divided = divide_cameras(options.dome.cameras, needs, kLeastCameras);
  CameraShares::Shares shares;
  for (std::size_t i = 0; i < wished.size(); ++i) shares[wished[i].name] = divided[i];
  std::ranges::stable_sort(wished, std::greater{}, &Wish::need);

  std::vector<std::string> placed;
  for (const Wish& wish : wished) {
    InputRig& rig = rigs_[wish.name];
    if (shares.at(wish.name) == 0) continue;
    const auto due_cameras = static_cast<std::size_t>(std::min(shares.at(wish.name), kLeastCameras));
    const bool robbed = rig.cameras.size() + rig.to_come.size() < due_cameras;
    std::size_t ahead = 0;
    if (anew || is_due(options, wish, robbed, rig, now_ns)) {
      ahead = place(options, wish, shares, now_ns);
    } else {
      if (options.glance_share > 0 && options.input_rate_hz <= 0) follow_eye(options, wish, rig, now_ns, cameras);
      if (rig.to_come.empty() || !rig.round.missing().empty()) continue;
    }
    grow(options, cameras, ahead, rig);
    placed.push_back(wish.name);
  }
  const std::size_t before = rigs_.size();
  forget_left(wished, shares);
  if (!anew && placed.empty() && rigs_.size() == before) return {};
  return request(options, placed, now_ns, cameras);
}

std::vector<InputRigs::Wish> InputRigs::wishes(const Options& options, const Viewers& viewers,
                                               const RangeFinder& ranges) {
  std::vector<Wish> wished;
  const auto add = [&](const std::string& name, const Viewer* viewer, const FreeSpace* free) {
    const InputRig& rig = rigs_[name];
    Wish wish{.name = name,
              .viewer = viewer,
              .free = free,
              .place = dome_place(options.placement, viewer, free, rig.place.heading_radians)};
    const float moved = glm::distance(wish.place.centre, rig.place.centre) / options.dome.radius_m;
    const float most = std::max(moved, turned(wish.place, rig.place) / glm::pi<float>());
    wish.need = rig.placed() ? std::min(1.0F, most) + rig.new_share : 2.0F;
    wished.push_back(std::move(wish));
  };
  const std::vector<std::string> names = viewers.in_order();
  if (names.empty() || options.placement.fixed_centre) {
    add("", names.empty() ? nullptr : &viewers.all().at(names.front()), nullptr);
    return wished;
  }
  for (const std::string& name : names) {
    const Viewer& viewer = viewers.all().at(name);
    add(name, &viewer, ranges.about(name, viewer.position()));
  }
  return wished;
}

bool InputRigs::is_due(const Options& options, const Wish& wish, bool robbed, InputRig& rig,
                       std::int64_t now_ns) const {
  const bool moved = glm::distance(wish.place.centre, rig.place.centre) > options.placement.move_m ||
                     turned(wish.place, rig.place) > options.placement.turn_radians;
  const bool can_be_tested = !rig.tested && wish.free != nullptr;
  if (rig.placed() && !moved && !can_be_tested && !robbed) return false;
  // A rig that an engine is rendering stays until its pictures are there, or a viewer on the move would never see one
  // complete. Whoever jumps is elsewhere at once, but for those that do nothing else.
  const std::int64_t deadline_ns = nanoseconds(options.input_deadline_s);
  const bool renders = answered_ && !rig.round.missing().empty() && now_ns - rig.asked_ns < deadline_ns;
  const bool jumped = wish.viewer != nullptr && wish.viewer->jumps != rig.jumps;
  const bool just_jumped = rig.jumped_ns && now_ns - *rig.jumped_ns < deadline_ns;
  if (rig.placed() && renders && (!jumped || just_jumped)) return false;
  if (wish.viewer == nullptr || options.placement.fixed_centre || options.range.rate_hz <= 0 || wish.free != nullptr) {
    rig.waits_since_ns.reset();
    return true;
  }
  if (!rig.waits_since_ns) rig.waits_since_ns = now_ns;
  return now_ns - *rig.waits_since_ns >= kRangePatienceNs;
}

std::size_t InputRigs::place(const Options& options, const Wish& wish, const CameraShares::Shares& shares,
                             std::int64_t now_ns) {
  shares_.take_share(wish.name, shares);
  const std::span<const std::uint32_t> ids = shares_.of(wish.name);
  InputRig& rig = rigs_.at(wish.name);
  if (wish.viewer != nullptr && wish.viewer->jumps != std::exchange(rig.jumps, wish.viewer->jumps)) {
    rig.jumped_ns = now_ns;
  }
  rig.place = wish.place;
  rig.tested = wish.free != nullptr;
  rig.anchor = wish.free != nullptr     ? wish.free->place()
               : wish.viewer != nullptr ? wish.viewer->position()
                                        : wish.place.centre + glm::vec3(0, options.dome.radius_m, 0);
  std::vector<Camera> ahead;
  if (wish.viewer != nullptr && !options.placement.fixed_centre && ids.size() > 1) {
    const Camera eye = eye_camera(options.dome, options.placement, *wish.viewer, wish.free, options.clearance_m);
    const std::size_t most = (ids.size() - 1) / kCamerasForEachAbout;
    ahead = cameras_about(eye, wish.free, std::min(static_cast<std::size_t>(options.placement.about), most));
    ahead.insert(ahead.begin(), eye);
    rig.eye_wished = eye.world_from_camera;
  }
  DomeOptions dome = options.dome;
  dome.cameras = static_cast<int>(ids.size() - ahead.size());
  const std::vector<Camera> stands = free_dome(dome, wish.place, wish.free, options.clearance_m);
  // Where the one before never got its dome, because the viewer passed it sooner, this one does not wait for its own.
  const bool goes_ahead = ahead.size() > 1 && rig.to_come.empty() && options.input_rate_hz <= 0;
  rig.cameras.clear();
  rig.to_come.clear();
  rig.about.clear();
  rig.blind.clear();
  rig.eye = ahead.empty() ? std::nullopt : std::optional(ids.front());
  rig.eye_in_flight = false;
  const auto add = [&](Camera camera, std::uint32_t id) {
    camera.id = id;
    camera.near_m = options.near_m;
    camera.far_m = options.far_m;
    rig.to_come.push_back(camera);
  };
  // Others take the last ids first: what looks about can be missed sooner than the dome, and the eye last of all.
  for (std::size_t k = 0; k < ahead.size(); ++k) {
    const std::uint32_t id = k == 0 ? ids.front() : ids[ids.size() - k];
    if (k > 0) rig.about.insert(id);
    add(ahead[k], id);
  }
  const std::vector<std::size_t> places = spread_places(stands.size());
  const std::size_t first = ahead.empty() ? 0 : 1;
  for (std::size_t k = 0; k < stands.size(); ++k) add(stands[places[k]], ids[first + k]);
  return goes_ahead ? ahead.size() : 0;
}

void InputRigs::grow(const Options& options, const CameraSet& cameras, std::size_t ahead, InputRig& rig) {
  std::size_t most = rig.to_come.size();
  const auto first = std::span(rig.to_come).first(ahead);
  const auto to_render = std::ranges::count_if(first, [&](const Camera& camera) { return !cameras.asks_for(camera); });
  if (to_render > 0) most = static_cast<std::size_t>(to_render);
  // At a rate all cameras are rendered again and again, wherever they stand.
  if (pictures_per_s_ && options.input_rate_hz <= 0) {
    const double in_time = *pictures_per_s_ * options.input_deadline_s;
    most = std::min(most, static_cast<std::size_t>(std::max<double>(kLeastCameras, in_time)));
  }
  std::size_t taken = 0;
  std::erase_if(rig.to_come, [&](const Camera& camera) {
    const bool stands = cameras.asks_for(camera);  // and costs nothing
    if (!stands) placed_.push_back(camera.id);
    if (!stands && taken++ >= most) return false;
    rig.cameras.push_back(camera);
    return true;
  });
}

void InputRigs::follow_eye(const Options& options, const Wish& wish, InputRig& rig, std::int64_t now_ns,
                           CameraSet& cameras) {
  if (!rig.eye || wish.viewer == nullptr || !rig.round.shows(*rig.eye)) return;
  if (now_ns - rig.eye_asked_ns < (rig.eye_in_flight ? nanoseconds(options.input_deadline_s) : kEyePeriodNs)) return;
  const auto eye = std::ranges::find(rig.cameras, *rig.eye, &Camera::id);
  if (eye == rig.cameras.end()) return;
  Camera now = eye_camera(options.dome, options.placement, *wish.viewer, wish.free, options.clearance_m);
  const Rigid &from = rig.eye_wished, &to = now.world_from_camera;
  const bool moved = glm::distance(from.translation, to.translation) > kEyeMove_m;
  const bool turned = glm::dot(from.rotation * glm::vec3(0, 0, 1), to.rotation * glm::vec3(0, 0, 1)) < kEyeTurn;
  const bool is_lost = rig.eye_in_flight;
  if (!moved && !turned && !is_lost) return;
  rig.eye_wished = to;
  rig.eye_asked_ns = now_ns;
  rig.eye_in_flight = true;
  now.id = eye->id;
  now.near_m = options.near_m;
  now.far_m = options.far_m;
  *eye = now;
  cameras.move(CameraRole::Input, now);
  placed_.push_back(now.id);
  renew(rig, cameras);
}

/// Rigs whose viewer has left stay until those who are there have theirs: their cameras are not to be missed before.
void InputRigs::forget_left(const std::vector<Wish>& wishes, const CameraShares::Shares& shares) {
  const bool all_placed = std::ranges::all_of(
      wishes, [&](const Wish& wish) { return shares.at(wish.name) == 0 || rigs_.at(wish.name).placed(); });
  if (!all_placed) return;
  std::erase_if(rigs_, [&](const auto& entry) {
    if (shares.contains(entry.first)) return false;
    shares_.release(entry.first);
    return true;
  });
}

std::vector<Camera> InputRigs::request(const Options& options, const std::vector<std::string>& placed,
                                       std::int64_t now_ns, CameraSet& cameras) {
  std::vector<Camera> wanted;
  for (auto& [name, rig] : rigs_) {
    const auto ids = shares_.of(name);
    const auto gone = [&](const Camera& camera) { return std::ranges::find(ids, camera.id) == ids.end(); };
    for (const Camera& camera : rig.cameras) {
      if (gone(camera)) rig.round.drop(camera.id);
    }
    std::erase_if(rig.cameras, gone);
    std::erase_if(rig.to_come, gone);
    wanted.insert(wanted.end(), rig.cameras.begin(), rig.cameras.end());
    // Until it is asked for anew a camera keeps the picture of where it was.
    for (const CameraRequest& before : cameras.of_role(CameraRole::Input)) {
      if (std::ranges::count(rig.to_come, before.camera.id, &Camera::id) > 0) wanted.push_back(before.camera);
    }
  }
  EngineBuffer buffers = EngineBuffer::Color | EngineBuffer::Albedo | EngineBuffer::WorldPosition |
                         EngineBuffer::Normal | EngineBuffer::ObjectId;
  // A view without it would train the far field where it shows through what nothing models yet.
  if (options.input_views && options.reference_depth) buffers |= EngineBuffer::Depth;
  auto left = cameras.replace(CameraRole::Input, wanted, buffers, options.input_rate_hz);
  for (auto& [name, rig] : rigs_) {
    if (std::ranges::find(placed, name) == placed.end()) {
      renew(rig, cameras);
      continue;
    }
    const auto before = std::exchange(rig.requested, own_requests(rig, cameras));
    if (before == rig.requested && rig.round.rig_generation() != 0) continue;
    std::vector<CameraRequest> requests;
    for (const CameraRequest& one : cameras.of_role(CameraRole::Input)) {
      const std::uint32_t id = one.camera.id;
      const auto blind = rig.blind.find(id);
      const bool given_up = blind != rig.blind.end() && blind->second >= kMaxBlind;
      if (rig.requested.contains(id) && !given_up) requests.push_back(one);
    }
    rig.round.begin(requests, ++generations_);
    rig.asked_ns = now_ns;
    rig.begun_ns = answered_ ? std::optional(now_ns) : std::nullopt;
    rig.arrivals = 0;
    rig.patience_ns = 0;
  }
  return left;
}

std::map<std::uint32_t, std::uint64_t> InputRigs::own_requests(const InputRig& rig, const CameraSet& cameras) {
  std::map<std::uint32_t, std::uint64_t> requested;
  for (const CameraRequest& one : cameras.of_role(CameraRole::Input)) {
    const bool own = std::ranges::any_of(rig.cameras, [&](const Camera& camera) { return camera.id == one.camera.id; });
    if (own) requested[one.camera.id] = one.request_id;
  }
  return requested;
}

void InputRigs::renew(InputRig& rig, const CameraSet& cameras) {
  rig.requested = own_requests(rig, cameras);
  rig.round.renew(cameras.of_role(CameraRole::Input));
}

InputRig* InputRigs::awaiting(std::uint32_t camera_id, std::uint64_t request_id) {
  const auto found =
      std::ranges::find_if(rigs_, [&](const auto& entry) { return entry.second.round.awaits(camera_id, request_id); });
  return found == rigs_.end() ? nullptr : &found->second;
}

void InputRigs::arrived(InputRig& rig, std::uint32_t camera_id, std::uint64_t request_id, InputViewPointer view,
                        std::int64_t now_ns) {
  rig.blind.erase(camera_id);
  answered_ = true;
  if (camera_id == rig.eye && std::exchange(rig.eye_in_flight, false)) {
    // The dome's pictures are waited for as if this had not come.
    rig.round.replace(camera_id, request_id, view);
    rig.glance = std::move(view);
    return;
  }
  const bool incomplete = !rig.round.missing().empty();
  if (camera_id == rig.eye && !rig.round.shows(camera_id)) rig.glance = view;
  rig.round.add(camera_id, request_id, std::move(view), now_ns);
  ++rig.arrivals;
  if (incomplete && rig.round.missing().empty()) measure(rig, now_ns);
  rig.asked_ns = now_ns;
  rig.patience_ns = 0;
}

void InputRigs::blind(InputRig& rig, std::uint32_t camera_id, std::int64_t now_ns, CameraSet& cameras) {
  answered_ = true;
  const auto camera = std::ranges::find(rig.cameras, camera_id, &Camera::id);
  if (camera == rig.cameras.end()) return;
  // Elsewhere one that looks about would see what the eye does.
  int& blind = rig.blind[camera_id];
  blind = rig.about.contains(camera_id) ? kMaxBlind : blind + 1;
  if (blind >= kMaxBlind) {
    rig.round.drop(camera_id);
    if (rig.round.missing().empty()) measure(rig, now_ns);
    return;
  }
  const glm::vec3 eye = glm::mix(camera->world_from_camera.translation, rig.anchor, 0.5F);
  camera->world_from_camera = look_at(eye, rig.place.centre, 1, 1, 1).world_from_camera;
  cameras.move(CameraRole::Input, *camera);
  renew(rig, cameras);
  rig.asked_ns = now_ns;
}

void InputRigs::measure(const InputRig& rig, std::int64_t now_ns) {
  if (!rig.begun_ns) return;  // the engine may not have been there
  const double took_s = std::max(1e-3, static_cast<double>(now_ns - *rig.begun_ns) * 1e-9);
  const double now = static_cast<double>(rig.arrivals) / took_s;
  pictures_per_s_ = pictures_per_s_ ? std::midpoint(*pictures_per_s_, now) : now;
}

bool InputRigs::wait_for_pictures(std::int64_t deadline_ns) const {
  return std::ranges::any_of(rigs_, [&](const auto& entry) {
    const InputRig& rig = entry.second;
    return !rig.round.missing().empty() && rig.patience_ns <= deadline_ns;
  });
}

void InputRigs::reissue(std::uint32_t camera_id, CameraSet& cameras) {
  cameras.reissue(CameraRole::Input, std::span(&camera_id, 1));
  for (auto& [name, rig] : rigs_) renew(rig, cameras);
}

void InputRigs::reissue_missing(InputRig& rig, std::int64_t now_ns, CameraSet& cameras) {
  cameras.reissue(CameraRole::Input, rig.round.missing());
  renew(rig, cameras);
  rig.asked_ns = now_ns;
}

void InputRigs::reissue_all(CameraSet& cameras) {
  cameras.reissue_all(CameraRole::Input);
  for (auto& [name, rig] : rigs_) renew(rig, cameras);
}

void InputRigs::note_new_share(std::uint64_t rig_generation, float share) {
  for (auto& [name, rig] : rigs_) {
    if (rig.round.rig_generation() == rig_generation) rig.new_share = share;
  }
}

}  // namespace splatbus::capture_bridge

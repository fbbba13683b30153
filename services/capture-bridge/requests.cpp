#include "capture-bridge/requests.h"

#include <algorithm>
#include <utility>

namespace splatbus::capture_bridge {

namespace {

constexpr std::int64_t kRefreshedNs = 100'000'000;

bool same(const Camera& a, const Camera& b) {
  return a.width == b.width && a.height == b.height && a.fx == b.fx && a.fy == b.fy && a.cx == b.cx && a.cy == b.cy &&
         a.near_m == b.near_m && a.far_m == b.far_m && a.world_from_camera.rotation == b.world_from_camera.rotation &&
         a.world_from_camera.translation == b.world_from_camera.translation;
}

bool same(const CameraRequest& a, const CameraRequest& b) {
  return same(a.camera, b.camera) && a.buffers == b.buffers && a.rate_hz == b.rate_hz && a.light_id == b.light_id &&
         a.light_map == b.light_map && a.extent_m == b.extent_m;
}

auto is(CameraRole role, std::uint32_t id) {
  return [role, id](const CameraRequest& request) { return request.camera.role == role && request.camera.id == id; };
}

}  // namespace

std::vector<Camera> CameraSet::replace(CameraRole role, std::span<const Camera> cameras, wire::EngineBuffer buffers,
                                       float rate_hz) {
  std::vector<CameraRequest> wanted;
  wanted.reserve(cameras.size());
  for (const Camera& camera : cameras) wanted.push_back({.camera = camera, .buffers = buffers, .rate_hz = rate_hz});
  return replace(role, wanted);
}

std::vector<Camera> CameraSet::replace(CameraRole role, std::span<const CameraRequest> wanted) {
  std::vector<Camera> left;
  std::erase_if(requests_, [&](const CameraRequest& request) {
    if (request.camera.role != role) return false;
    const bool stays = std::any_of(wanted.begin(), wanted.end(),
                                   [&](const CameraRequest& one) { return one.camera.id == request.camera.id; });
    if (!stays) left.push_back(request.camera);
    return !stays;
  });
  changed_ = changed_ || !left.empty();
  for (const CameraRequest& one : wanted) {
    const auto found = std::find_if(requests_.begin(), requests_.end(), is(role, one.camera.id));
    if (found == requests_.end() || !same(*found, one)) add(one);
  }
  return left;
}

void CameraSet::reissue(CameraRole role, std::span<const std::uint32_t> ids) {
  for (CameraRequest& request : requests_) {
    if (request.camera.role != role || std::find(ids.begin(), ids.end(), request.camera.id) == ids.end()) continue;
    request.request_id = ++last_request_id_;
    changed_ = true;
  }
}

void CameraSet::reissue_all(CameraRole role) {
  for (CameraRequest& request : requests_) {
    if (request.camera.role != role) continue;
    request.request_id = ++last_request_id_;
    changed_ = true;
  }
}

std::uint64_t CameraSet::add(const Camera& camera, wire::EngineBuffer buffers, float rate_hz) {
  return add({.camera = camera, .buffers = buffers, .rate_hz = rate_hz});
}

std::uint64_t CameraSet::add(CameraRequest request) {
  request.request_id = ++last_request_id_;
  const auto found = std::find_if(requests_.begin(), requests_.end(), is(request.camera.role, request.camera.id));
  if (found == requests_.end()) {
    requests_.push_back(request);
  } else {
    *found = request;
  }
  changed_ = true;
  return last_request_id_;
}

void CameraSet::remove(CameraRole role, std::uint32_t id) {
  changed_ = std::erase_if(requests_, is(role, id)) > 0 || changed_;
}

void CameraSet::move(CameraRole role, const Camera& camera) {
  const auto found = std::find_if(requests_.begin(), requests_.end(), is(role, camera.id));
  if (found == requests_.end()) return;
  found->camera = camera;
  found->request_id = ++last_request_id_;
  changed_ = true;
}

std::vector<CameraRequest> CameraSet::of_role(CameraRole role) const {
  std::vector<CameraRequest> found;
  std::copy_if(requests_.begin(), requests_.end(), std::back_inserter(found),
               [role](const CameraRequest& request) { return request.camera.role == role; });
  return found;
}

bool CameraSet::asks_for(const Camera& camera) const {
  const auto found = std::find_if(requests_.begin(), requests_.end(), is(camera.role, camera.id));
  return found != requests_.end() && same(found->camera, camera);
}

bool CameraSet::asks_for(CameraRole role, std::uint32_t camera_id, std::uint64_t request_id) const {
  const auto found = std::find_if(requests_.begin(), requests_.end(), is(role, camera_id));
  return found != requests_.end() && found->request_id == request_id;
}

bool CameraSet::take_changed() {
  return std::exchange(changed_, false);
}

std::optional<std::uint32_t> StalestFirst::take(std::uint64_t scene_version, std::int64_t now_ns) {
  auto stalest = pictures_.end();
  for (auto it = pictures_.begin(); it != pictures_.end(); ++it) {
    const Picture& picture = it->second;
    if (picture.scene_version >= scene_version) continue;
    if (picture.asked_anew_ns && now_ns - *picture.asked_anew_ns < kPatienceNs) continue;
    if (stalest == pictures_.end() || picture.scene_version < stalest->second.scene_version) stalest = it;
  }
  if (stalest == pictures_.end()) return std::nullopt;
  stalest->second.asked_anew_ns = now_ns;
  return stalest->first;
}

void InputRound::begin(std::span<const CameraRequest> requests, std::uint64_t rig_generation) {
  const std::vector<Slot> before = std::exchange(slots_, {});
  for (const CameraRequest& request : requests) {
    Slot slot{.camera_id = request.camera.id, .request_id = request.request_id, .view = nullptr};
    const auto same = std::ranges::find_if(
        before, [&](const Slot& old) { return old.camera_id == slot.camera_id && old.request_id == slot.request_id; });
    if (same != before.end()) slot.view = same->view;
    slot.fresh = slot.view != nullptr;  // the new round has it too
    slots_.push_back(std::move(slot));
  }
  first_fresh_ns_.reset();
  handed_on_incomplete_ = handed_on_whole_ = false;
  rig_generation_ = rig_generation;
}

void InputRound::renew(std::span<const CameraRequest> requests) {
  for (const CameraRequest& request : requests) {
    for (Slot& slot : slots_) {
      if (slot.camera_id == request.camera.id) slot.request_id = request.request_id;
    }
  }
}

void InputRound::drop(std::uint32_t camera_id) {
  std::erase_if(slots_, [camera_id](const Slot& slot) { return slot.camera_id == camera_id; });
}

bool InputRound::awaits(std::uint32_t camera_id, std::uint64_t request_id) const {
  return std::ranges::any_of(slots_, [&](const Slot& candidate) {
    return candidate.camera_id == camera_id && candidate.request_id == request_id;
  });
}

InputRound::Slot* InputRound::find(std::uint32_t camera_id, std::uint64_t request_id) {
  const auto slot = std::ranges::find_if(slots_, [&](const Slot& candidate) {
    return candidate.camera_id == camera_id && candidate.request_id == request_id;
  });
  return slot == slots_.end() ? nullptr : &*slot;
}

bool InputRound::add(std::uint32_t camera_id, std::uint64_t request_id, InputViewPointer view, std::int64_t now_ns) {
  Slot* const slot = find(camera_id, request_id);
  if (slot == nullptr) return false;
  slot->view = std::move(view);
  slot->fresh = true;
  if (!first_fresh_ns_) first_fresh_ns_ = now_ns;
  return true;
}

bool InputRound::replace(std::uint32_t camera_id, std::uint64_t request_id, InputViewPointer view) {
  Slot* const slot = find(camera_id, request_id);
  if (slot == nullptr) return false;
  slot->view = std::move(view);
  return true;
}

bool InputRound::ready(std::int64_t now_ns, std::int64_t deadline_ns) const {
  if (!first_fresh_ns_) return false;
  const bool full = std::all_of(slots_.begin(), slots_.end(), [](const Slot& slot) { return slot.fresh; });
  // Stragglers complete a rig whose other frames were handed on already.
  const bool completed = handed_on_incomplete_ && missing().empty();
  const std::int64_t patience_ns = handed_on_whole_ ? std::min(deadline_ns, kRefreshedNs) : deadline_ns;
  return full || completed || now_ns - *first_fresh_ns_ >= patience_ns;
}

std::vector<InputViewPointer> InputRound::take() {
  for (Slot& slot : slots_) slot.fresh = false;
  first_fresh_ns_.reset();
  handed_on_incomplete_ = !missing().empty();
  handed_on_whole_ = !handed_on_incomplete_;
  return views();
}

std::vector<InputViewPointer> InputRound::take_fresh() {
  std::vector<InputViewPointer> fresh;
  for (const Slot& slot : slots_) {
    if (slot.fresh) fresh.push_back(slot.view);
  }
  static_cast<void>(take());
  return fresh;
}

bool InputRound::shows(std::uint32_t camera_id) const {
  return std::ranges::any_of(slots_, [&](const Slot& slot) { return slot.camera_id == camera_id && slot.view; });
}

std::vector<std::uint32_t> InputRound::missing() const {
  std::vector<std::uint32_t> ids;
  for (const Slot& slot : slots_) {
    if (!slot.view) ids.push_back(slot.camera_id);
  }
  return ids;
}

bool InputRound::empty() const {
  return std::none_of(slots_.begin(), slots_.end(), [](const Slot& slot) { return slot.view != nullptr; });
}

std::vector<InputViewPointer> InputRound::views() const {
  std::vector<InputViewPointer> found;
  for (const Slot& slot : slots_) {
    if (slot.view) found.push_back(slot.view);
  }
  return found;
}

}  // namespace splatbus::capture_bridge

#include "capture-bridge/input_round.h"

#include <algorithm>

namespace splatbus::capture_bridge {

void InputRound::begin(std::span<const CameraRequest> requests) {
  slots_.clear();
  for (const CameraRequest& request : requests) {
    slots_.push_back({.camera_id = request.camera.id, .request_id = request.request_id, .view = nullptr});
  }
  first_fresh_ns_.reset();
  handed_on_incomplete_ = false;
  ++rig_generation_;
}

void InputRound::renew(std::span<const CameraRequest> requests) {
  for (const CameraRequest& request : requests) {
    for (Slot& slot : slots_) {
      if (slot.camera_id == request.camera.id) slot.request_id = request.request_id;
    }
  }
}

bool InputRound::add(std::uint32_t camera_id, std::uint64_t request_id, InputViewPointer view, std::int64_t now_ns) {
  const auto slot = std::find_if(slots_.begin(), slots_.end(), [&](const Slot& candidate) {
    return candidate.camera_id == camera_id && candidate.request_id == request_id;
  });
  if (slot == slots_.end()) return false;
  slot->view = std::move(view);
  slot->fresh = true;
  if (!first_fresh_ns_) first_fresh_ns_ = now_ns;
  return true;
}

bool InputRound::ready(std::int64_t now_ns, std::int64_t deadline_ns) const {
  if (!first_fresh_ns_) return false;
  const bool full = std::all_of(slots_.begin(), slots_.end(), [](const Slot& slot) { return slot.fresh; });
  // Stragglers complete a rig whose other frames were handed on already.
  const bool completed = handed_on_incomplete_ && missing().empty();
  return full || completed || now_ns - *first_fresh_ns_ >= deadline_ns;
}

std::vector<InputViewPointer> InputRound::take() {
  for (Slot& slot : slots_) slot.fresh = false;
  first_fresh_ns_.reset();
  handed_on_incomplete_ = !missing().empty();
  return views();
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

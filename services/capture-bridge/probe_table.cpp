#include "capture-bridge/probe_table.h"

#include <algorithm>

namespace splatbus::capture_bridge {

Probe* ProbeTable::add(std::uint64_t probe_id, const std::string& asker, const Camera& camera, std::int64_t now_ns,
                       std::optional<Probe>& evicted) {
  const auto waits = [&](const Probe& probe) { return probe.probe_id == probe_id && probe.asker == asker; };
  if (std::any_of(waiting_.begin(), waiting_.end(), waits)) return nullptr;
  if (waiting_.size() >= capacity_) {
    evicted = waiting_.front();
    waiting_.pop_front();
  }
  Probe probe{.probe_id = probe_id, .asker = asker, .camera = camera, .asked_ns = now_ns, .requested_ns = now_ns};
  probe.camera.id = next_camera_id_++;
  probe.camera.role = CameraRole::Probe;
  waiting_.push_back(probe);
  return &waiting_.back();
}

std::optional<Probe> ProbeTable::answer(std::uint32_t camera_id, std::uint64_t request_id) {
  const auto found = std::find_if(waiting_.begin(), waiting_.end(), [&](const Probe& probe) {
    return probe.camera.id == camera_id && probe.first_request_id <= request_id && request_id <= probe.request_id;
  });
  if (found == waiting_.end()) return std::nullopt;
  Probe probe = *found;
  waiting_.erase(found);
  return probe;
}

void ProbeTable::ask(Probe& probe, std::uint64_t request_id, std::int64_t now_ns) {
  if (probe.first_request_id == 0) probe.first_request_id = request_id;
  probe.request_id = request_id;
  probe.requested_ns = now_ns;
}

std::vector<Probe> ProbeTable::expire(std::int64_t asked_before_ns) {
  std::vector<Probe> gone;
  while (!waiting_.empty() && waiting_.front().asked_ns < asked_before_ns) {
    gone.push_back(waiting_.front());
    waiting_.pop_front();
  }
  return gone;
}

std::vector<Probe*> ProbeTable::overdue(std::int64_t requested_before_ns) {
  std::vector<Probe*> late;
  for (Probe& probe : waiting_) {
    if (probe.requested_ns < requested_before_ns) late.push_back(&probe);
  }
  return late;
}

}  // namespace splatbus::capture_bridge

#include "sim/schedule.h"

#include <algorithm>

namespace splatbus::sim {

void Schedule::replace(std::span<const splatbus_camera_request> requests) {
  std::map<std::pair<std::uint32_t, std::uint32_t>, Entry> next;
  for (const splatbus_camera_request& request : requests) {
    const std::pair key{request.camera.role, request.camera.id};
    Entry entry{.request = request};
    const auto known = entries_.find(key);
    entry.newcomer = known == entries_.end();
    if (known != entries_.end() && known->second.request.request_id == request.request_id &&
        known->second.request.rate_hz == request.rate_hz) {
      entry = known->second;
      entry.request = request;
    }
    next.insert_or_assign(key, entry);
  }
  entries_ = std::move(next);
}

std::vector<splatbus_camera_request> Schedule::due(double time_s, std::uint64_t scene_version) {
  return serve(time_s, scene_version, false);
}

std::vector<splatbus_camera_request> Schedule::newcomers(double time_s, std::uint64_t scene_version) {
  return serve(time_s, scene_version, true);
}

std::vector<splatbus_camera_request> Schedule::serve(double time_s, std::uint64_t scene_version, bool newcomers_only) {
  constexpr double kTolerance_s = 1e-6;
  std::vector<splatbus_camera_request> due;
  for (auto& [key, entry] : entries_) {
    if (newcomers_only && (entry.served || !entry.newcomer)) continue;
    const splatbus_camera_request& request = entry.request;
    const bool changed = request.camera.role == SPLATBUS_ROLE_LIGHT && entry.scene_version != scene_version;
    const bool is_due = !entry.served || (request.rate_hz > 0 ? time_s >= entry.next_due_s - kTolerance_s : changed);
    if (!is_due) continue;
    if (request.rate_hz > 0) {
      const double period_s = 1.0 / request.rate_hz;
      // An engine that fell behind goes on from now; it does not catch up.
      const bool behind = !entry.served || time_s > entry.next_due_s + period_s;
      entry.next_due_s = (behind ? time_s : entry.next_due_s) + period_s;
    }
    entry.served = true;
    entry.scene_version = scene_version;
    due.push_back(request);
  }
  std::stable_partition(due.begin(), due.end(),
                        [](const auto& request) { return request.camera.role == SPLATBUS_ROLE_PROBE; });
  return due;
}

bool Schedule::repeats(const std::pair<std::uint32_t, std::uint32_t>& key) const {
  const auto found = entries_.find(key);
  return found != entries_.end() && found->second.request.rate_hz > 0;
}

bool Schedule::watches_scene() const {
  return std::ranges::any_of(entries_, [](const auto& entry) {
    return entry.second.request.camera.role == SPLATBUS_ROLE_LIGHT && entry.second.request.rate_hz <= 0;
  });
}

}  // namespace splatbus::sim

#include "sim/schedule.h"

#include <algorithm>

namespace splatbus::sim {
namespace {

bool is_light(const splatbus_camera_request& request) {
  return request.camera.role == SPLATBUS_ROLE_LIGHT;
}

bool same_rhythm(const splatbus_camera_request& a, const splatbus_camera_request& b) {
  if (a.request_id != b.request_id) return false;
  if (!is_light(a)) return a.rate_hz == b.rate_hz;
  return a.light_id == b.light_id && a.light_map == b.light_map && a.extent_m == b.extent_m;
}

}  // namespace

void Schedule::replace(std::span<const splatbus_camera_request> requests) {
  std::map<std::pair<std::uint32_t, std::uint32_t>, Entry> next;
  for (const splatbus_camera_request& request : requests) {
    const std::pair key{request.camera.role, request.camera.id};
    Entry entry{.request = request};
    const auto known = entries_.find(key);
    entry.newcomer = known == entries_.end();
    if (known != entries_.end() && same_rhythm(known->second.request, request)) {
      entry = known->second;
      entry.request = request;
    } else if (known != entries_.end() && known->second.postponed) {
      // Asked for anew while it waited: it keeps its turn.
      entry.postponed = true;
      entry.due_since_s = known->second.due_since_s;
    }
    next.insert_or_assign(key, entry);
  }
  entries_ = std::move(next);
}

std::vector<splatbus_camera_request> Schedule::due(double time_s, const DepthVersion& depth_version) {
  return serve(time_s, depth_version, false);
}

std::vector<splatbus_camera_request> Schedule::newcomers(double time_s, const DepthVersion& depth_version) {
  return serve(time_s, depth_version, true);
}

std::vector<splatbus_camera_request> Schedule::serve(double time_s, const DepthVersion& depth_version,
                                                     bool newcomers_only) {
  constexpr double kTolerance_s = 1e-6;
  struct Due {
    splatbus_camera_request request;
    double since_s;
  };
  std::vector<Due> due;
  for (auto& [key, entry] : entries_) {
    if (newcomers_only && (entry.served || !entry.newcomer || entry.postponed)) continue;
    const splatbus_camera_request& request = entry.request;
    if (is_light(request)) {
      const std::optional<std::uint64_t> version = depth_version(request);
      if (!version || (entry.served && entry.depth_version == *version)) continue;
      entry.depth_version = *version;
    } else {
      const bool repeated = request.rate_hz > 0;
      if (entry.served && !(repeated && time_s >= entry.next_due_s - kTolerance_s)) continue;
      if (!entry.postponed) entry.due_since_s = entry.served ? entry.next_due_s : time_s;
      entry.postponed = false;
      if (repeated) {
        const double period_s = 1.0 / request.rate_hz;
        // An engine that fell behind goes on from now; it does not catch up.
        const bool behind = !entry.served || time_s > entry.next_due_s + period_s;
        entry.next_due_s = (behind ? time_s : entry.next_due_s) + period_s;
      }
    }
    entry.served = true;
    due.push_back({request, entry.due_since_s});
  }
  const auto order = [](const Due& entry) {
    const bool probe = entry.request.camera.role == SPLATBUS_ROLE_PROBE;
    return is_light(entry.request) ? std::pair(0, 0.0) : probe ? std::pair(1, 0.0) : std::pair(2, entry.since_s);
  };
  std::ranges::stable_sort(due, {}, order);
  std::vector<splatbus_camera_request> requests;
  requests.reserve(due.size());
  for (const Due& entry : due) requests.push_back(entry.request);
  return requests;
}

void Schedule::postpone(const splatbus_camera_request& request) {
  const auto entry = entries_.find({request.camera.role, request.camera.id});
  if (entry == entries_.end()) return;
  entry->second.served = false;
  entry->second.postponed = true;
}

bool Schedule::repeats(const std::pair<std::uint32_t, std::uint32_t>& key) const {
  const auto found = entries_.find(key);
  return found != entries_.end() && found->second.request.rate_hz > 0 && !is_light(found->second.request);
}

bool Schedule::watches_scene() const {
  return std::ranges::any_of(entries_, [](const auto& entry) { return is_light(entry.second.request); });
}

}  // namespace splatbus::sim

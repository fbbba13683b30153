#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "sdk/splatbus_engine.h"

namespace splatbus::sim {

/// Which camera requests are due at a frame. A request with a rate is due at once and then every 1 / rate seconds of
/// engine time; one without is due once for each request_id. One of role light, whatever its rate, is due once for each
/// request_id, and again whenever its light has another depth version; while there is no such light, it waits.
class Schedule {
 public:
  /// The depth version of the light that a request of role light names; nothing while there is no such map.
  using DepthVersion = std::function<std::optional<std::uint64_t>(const splatbus_camera_request&)>;

  /// The whole set of requests; what was known under the same role, id, request_id and rate, and of role light the same
  /// light and map, keeps its rhythm.
  void replace(std::span<const splatbus_camera_request> requests);

  /// Requests that are due; they count as served. Lights come first, so that a picture's depth maps are there before
  /// it, then probes, then what has been due for longest.
  [[nodiscard]] std::vector<splatbus_camera_request> due(double time_s, const DepthVersion& depth_version);

  /// Of these only what was asked for of cameras that no set had before the last: few, and someone waits for them. A
  /// camera that moves is asked for again and again, and waits for the next frame.
  [[nodiscard]] std::vector<splatbus_camera_request> newcomers(double time_s, const DepthVersion& depth_version);

  /// Of what due() returned last: it was not rendered after all, and stays due.
  void postpone(const splatbus_camera_request& request);

  /// True when due() would depend on whether the scene has changed.
  [[nodiscard]] bool watches_scene() const;
  /// True for a request (role, id) with a rate that counts.
  [[nodiscard]] bool repeats(const std::pair<std::uint32_t, std::uint32_t>& key) const;
  [[nodiscard]] std::size_t size() const { return entries_.size(); }

 private:
  std::vector<splatbus_camera_request> serve(double time_s, const DepthVersion& depth_version, bool newcomers_only);

  struct Entry {
    splatbus_camera_request request;
    bool served = false;
    bool newcomer = true;
    double next_due_s = 0;
    double due_since_s = 0;  ///< what was served last, or is postponed
    bool postponed = false;
    std::uint64_t depth_version = 0;
  };
  std::map<std::pair<std::uint32_t, std::uint32_t>, Entry> entries_;  ///< by role and id
};

}  // namespace splatbus::sim

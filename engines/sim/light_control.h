#pragma once

#include <cstddef>
#include <optional>
#include <string>

#include "bus/subscriber.h"

namespace splatbus::sim {

/// What shall be different about the light.
struct LightChanges {
  std::optional<double> sun_azimuth_deg;  ///< about the vertical from +x towards +z
  std::optional<bool> night, lamps_shown;
  std::optional<std::size_t> point_lights;
};

/// How the light shall be, as control/engine-sim says at run time: { sun_azimuth_deg, night (0 or 1), point_lights (0
/// to kLamps), lamps_shown (0 or 1: whether what shines is seen itself) }. The answer is the light of the frames that
/// follow. Not thread-safe.
class LightControl {
 public:
  /// Joins the bus beside the engine `name`. An empty address is the default bus.
  LightControl(const std::string& address, const std::string& name);

  /// The newest of each since the last call. What makes no sense is logged and passed over.
  [[nodiscard]] LightChanges take();

 private:
  bus::Subscriber subscriber_;
  LightChanges changes_;
};

}  // namespace splatbus::sim

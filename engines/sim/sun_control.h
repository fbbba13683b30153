#pragma once

#include <optional>
#include <string>

#include "bus/subscriber.h"

namespace splatbus::sim {

/// Where the sun shall stand, as control/engine-sim says at run time: { sun_azimuth_deg }. The answer is the light of
/// the frames that follow. Not thread-safe.
class SunControl {
 public:
  /// Joins the bus beside the engine `name`. An empty address is the default bus.
  SunControl(const std::string& address, const std::string& name);

  /// The newest azimuth since the last call, degrees about the vertical from +x towards +z. What is no finite number is
  /// logged and passed over.
  [[nodiscard]] std::optional<double> take_azimuth_deg();

 private:
  bus::Subscriber subscriber_;
  std::optional<double> azimuth_deg_;
};

}  // namespace splatbus::sim

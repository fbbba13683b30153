#include "sim/sun_control.h"

#include <spdlog/spdlog.h>

#include <charconv>
#include <chrono>
#include <cmath>
#include <utility>

#include "wire/system_generated.h"

namespace splatbus::sim {

SunControl::SunControl(const std::string& address, const std::string& name)
    : subscriber_(bus::Context::create(
          address.empty() ? bus::Address::from_environment() : bus::Address::parse(address), name + "-sun")) {
  subscriber_.on(topics::control("control/engine-sim"), [this](const wire::Control& control, const bus::Message&) {
    if (control.changes() == nullptr) return;
    for (const auto* change : *control.changes()) {
      const std::string value = change->value()->str();
      double azimuth_deg = 0;
      const auto [end, error] = std::from_chars(value.data(), value.data() + value.size(), azimuth_deg);
      const bool number = error == std::errc() && end == value.data() + value.size() && std::isfinite(azimuth_deg);
      if (change->key()->str() == "sun_azimuth_deg" && number) {
        azimuth_deg_ = azimuth_deg;
      } else {
        spdlog::error("control/engine-sim: '{}' cannot be '{}'", change->key()->str(), value);
      }
    }
  });
}

std::optional<double> SunControl::take_azimuth_deg() {
  subscriber_.dispatch_all(std::chrono::milliseconds(0));
  return std::exchange(azimuth_deg_, {});
}

}  // namespace splatbus::sim

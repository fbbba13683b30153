#include "sim/light_control.h"

#include <spdlog/spdlog.h>

#include <charconv>
#include <chrono>
#include <cmath>
#include <utility>

#include "sim/lamps.h"
#include "wire/system_generated.h"

namespace splatbus::sim {
namespace {

std::optional<double> number(const std::string& text) {
  double value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size() || !std::isfinite(value)) return std::nullopt;
  return value;
}

/// False when there is no such key, or it cannot have that value.
bool change(LightChanges& changes, const std::string& key, double value) {
  const bool whole = value == std::floor(value);
  if (key == "sun_azimuth_deg") {
    changes.sun_azimuth_deg = value;
  } else if (key == "night" && (value == 0 || value == 1)) {
    changes.night = value == 1;
  } else if (key == "lamps_shown" && (value == 0 || value == 1)) {
    changes.lamps_shown = value == 1;
  } else if (key == "point_lights" && whole && value >= 0 && value <= static_cast<double>(kLamps)) {
    changes.point_lights = static_cast<std::size_t>(value);
  } else {
    return false;
  }
  return true;
}

}  // namespace

LightControl::LightControl(const std::string& address, const std::string& name)
    : subscriber_(bus::Context::create(
          address.empty() ? bus::Address::from_environment() : bus::Address::parse(address), name + "-light")) {
  subscriber_.on(topics::control("control/engine-sim"), [this](const wire::Control& control, const bus::Message&) {
    if (control.changes() == nullptr) return;
    for (const auto* entry : *control.changes()) {
      const std::string key = entry->key()->str(), value = entry->value()->str();
      const std::optional<double> parsed = number(value);
      if (!parsed || !change(changes_, key, *parsed)) {
        spdlog::error("control/engine-sim: '{}' cannot be '{}'", key, value);
      }
    }
  });
}

LightChanges LightControl::take() {
  subscriber_.dispatch_all(std::chrono::milliseconds(0));
  return std::exchange(changes_, {});
}

}  // namespace splatbus::sim

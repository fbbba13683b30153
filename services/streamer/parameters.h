#pragma once

#include <string>
#include <vector>

#include "bus/context.h"
#include "bus/parameters.h"
#include "stream/stream_model.h"

namespace splatbus::streamer {

[[nodiscard]] std::vector<bus::ParameterSpec> parameter_specs();

/// Where to bind: `endpoint` (empty: ipc, "streamer" in the bus's folder, when the bus is local) and `tcp`. Throws
/// bus::Error when that is nowhere.
[[nodiscard]] std::vector<std::string> endpoints(const bus::Parameters& parameters, const bus::Address& address);

[[nodiscard]] stream::Schedules schedules(const bus::Parameters& parameters);

}  // namespace splatbus::streamer

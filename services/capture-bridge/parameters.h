#pragma once

#include <vector>

#include "bus/parameters.h"
#include "capture-bridge/rig.h"
#include "capture-bridge/round_plan.h"

namespace splatbus::capture_bridge {

[[nodiscard]] std::vector<bus::ParameterSpec> parameter_specs();

/// The parameters as the parts take them.
[[nodiscard]] DomeOptions dome_options(const bus::Parameters& parameters);
[[nodiscard]] InputRigTracker::Options tracker_options(const bus::Parameters& parameters);
[[nodiscard]] RingOptions ring_options(const bus::Parameters& parameters);
[[nodiscard]] FollowOptions follow_options(const bus::Parameters& parameters);
[[nodiscard]] SamplingOptions sampling_options(const bus::Parameters& parameters);
[[nodiscard]] RoundSizes round_sizes(const bus::Parameters& parameters);

}  // namespace splatbus::capture_bridge

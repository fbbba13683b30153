#pragma once

#include <string>
#include <vector>

#include "bus/parameters.h"
#include "gaussians/camera.h"

namespace splatbus::viewer {

/// The viewer's camera over time, as the parameters say: `orbit` turns about the target once a period, `still` stays
/// where the orbit begins.
[[nodiscard]] Camera path_camera(const bus::Parameters& parameters, double seconds);

[[nodiscard]] std::vector<bus::ParameterSpec> path_parameter_specs();

}  // namespace splatbus::viewer

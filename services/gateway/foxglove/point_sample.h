#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

#include "gaussians/light.h"
#include "gaussians/model.h"

namespace splatbus::gateway::foxglove {

/// x, y, z: metres in the world, f32; red, green, blue under the sRGB curve and opacity as alpha, u8.
inline constexpr std::uint32_t kPointBytes = 16;

/// Of every so manieth Gaussian of a model in host memory its mean, the part of its colour that is the same from all
/// sides under the scene's light, and its opacity; `max_points` at most, and the same ones as long as the structure
/// stays. Only these are read. Hidden Gaussians and the far field are left out. `gaussians`: with or without pages.
[[nodiscard]] std::string sample_points(const GaussiansView& gaussians, const SceneState& scene,
                                        std::size_t max_points);

}  // namespace splatbus::gateway::foxglove

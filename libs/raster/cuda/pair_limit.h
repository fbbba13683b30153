#pragma once

#include <cstdint>

namespace splatbus::raster::cuda {

/// Pairs of a Gaussian and a tile that one sort takes.
inline constexpr std::uint32_t kMostPairs = (1U << 31U) - 1024;

}  // namespace splatbus::raster::cuda

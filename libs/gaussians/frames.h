#pragma once

#include <cstdint>

// Frames of reference of Gaussians: an object's id, or one of these.
namespace splatbus {

/// Of what stands still.
inline constexpr std::uint32_t kWorldFrame = 0;
/// Of what lies beyond reach, the sky among it, which goes with whoever looks. No engine's object has this id.
inline constexpr std::uint32_t kFarFieldFrame = 0xFA00FA00;

}  // namespace splatbus

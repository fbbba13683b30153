#pragma once

#include <cstdint>

namespace splatbus {

/// Id of the object that is the camera of the engine's player: its frame has x right, y down, z forward, and no
/// Gaussians. SPLATBUS_PLAYER_ID.
inline constexpr std::uint32_t kPlayerId = 0xFA00FA01;

}  // namespace splatbus

#pragma once

#include <cstdint>

#include "stream/replicated_state.h"

namespace splatbus::stream {

/// Of every integer that is held, FNV-1a: two replicas that agree in it hold the same.
[[nodiscard]] std::uint64_t held_hash(const ReplicatedState& state);

}  // namespace splatbus::stream

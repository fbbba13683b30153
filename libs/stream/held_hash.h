#pragma once

#include <cstdint>

#include "stream/replicated_state.h"

namespace splatbus::stream {

/// Of every integer that is held, lane by lane of each page, FNV-1a: two replicas that agree in it hold the same, in
/// whatever rows.
[[nodiscard]] std::uint64_t held_hash(const ReplicatedState& state);

}  // namespace splatbus::stream

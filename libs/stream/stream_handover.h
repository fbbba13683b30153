#pragma once

#include <cstdint>
#include <span>

#include "stream/replicated_state.h"

namespace splatbus::stream {

/// A stream as one streamer leaves it to the next: who holds pages of it holds them still, and loads none anew.
struct StreamHandover {
  ReplicatedState held;       ///< the Gaussians' ids too
  std::uint32_t version = 0;  ///< of the newest page
};

/// Reads what StreamModel::hand_over() wrote (wire::StreamHandover): the packets by which a viewer would hold all of
/// it, and what viewers are not told. `bytes` are aligned to 8. Throws StreamError, naming what is wrong.
[[nodiscard]] StreamHandover read_handover(std::span<const std::uint8_t> bytes);

}  // namespace splatbus::stream

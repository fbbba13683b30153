#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>

#include "bus/counted_frames.h"
#include "bus/frames.h"
#include "bus/slab.h"

namespace splatbus::bus_service {

using FindSlab = std::function<std::shared_ptr<bus::Slab>(std::uint64_t id)>;

/// True when a tensor of the message lies in a slab.
bool has_slab_tensors(const wire::Header& header);

/// The message as a reader over tcp gets it: the bytes of its slab tensors in a third frame, behind those that are
/// inline already, and the Spans rewritten to say so; counted as `unsent`. Nullopt when a slab is gone or a slot was
/// overwritten. Throws bus::Error when a span lies.
std::optional<bus::Frames> inline_slab_tensors(const bus::Frames& frames, const FindSlab& find_slab,
                                               const UnsentBytes& unsent);

}  // namespace splatbus::bus_service

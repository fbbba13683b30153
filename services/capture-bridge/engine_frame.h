#pragma once

#include <atomic>
#include <cstdint>
#include <optional>

#include "bus/memory_pool.h"
#include "bus/subscriber.h"
#include "capture-bridge/input_view.h"
#include "wire/engine_generated.h"

namespace splatbus::capture_bridge {

/// Copies an input camera's frame out of the engine's slab into memory of the pool; the copies are done when this
/// returns. Adds to `host_bytes` what did not stay on the device. Nullopt when a buffer is gone or overwritten already
/// (a lost frame). Throws bus::Error or std::runtime_error, naming what is wrong, when the message lies.
[[nodiscard]] std::optional<InputView> decode_input_frame(const bus::Message& message, const wire::EngineFrame& frame,
                                                          bus::MemoryPool& pool,
                                                          std::atomic<std::uint64_t>& host_bytes);

}  // namespace splatbus::capture_bridge

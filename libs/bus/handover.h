#pragma once

#include <chrono>
#include <cstddef>
#include <functional>
#include <span>

#include "bus/context.h"

// What a process leaves for the next one of its name: the slab "<source>/handover", one slot of host memory.
namespace splatbus::bus {

/// Makes the slab and has `fill` write its `bytes` (more than 0). False where nobody could open it (a bus over tcp), or
/// no broker is there within `patience`: who ends without a successor is not to wait for one. Throws Error when there
/// is no memory for it, or the broker does not take it.
bool leave_handover(Context& bus, std::size_t bytes, const std::function<void(std::byte* memory)>& fill,
                    std::chrono::milliseconds patience = std::chrono::milliseconds(0));

/// Drops what was left and calls `take` with a copy of it, aligned to 16 bytes. False when nothing was left, or no
/// broker is there within `patience`. What is in it may be anything. Throws Error when it was not written to its end,
/// or has more than `most_bytes`.
bool take_handover(Context& bus, const std::function<void(std::span<const std::byte>)>& take,
                   std::size_t most_bytes = std::size_t{1} << 30U,
                   std::chrono::milliseconds patience = std::chrono::seconds(1));

}  // namespace splatbus::bus

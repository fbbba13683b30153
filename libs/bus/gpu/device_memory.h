#pragma once

#include <cstddef>
#include <memory>

namespace splatbus::bus::gpu {

// bus/memory.h for device memory. All throw bus::Error.

[[nodiscard]] std::shared_ptr<std::byte> allocate(std::size_t bytes);
[[nodiscard]] std::size_t free_bytes();
void enqueue_copy(void* destination, const void* source, std::size_t bytes);
void finish_copies();
void require_usable();

}  // namespace splatbus::bus::gpu

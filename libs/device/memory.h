#pragma once

#include <cstddef>

#include "device/stream.h"

// Memory of either device as bytes; Buffer (device/buffer.h) owns it. All of it throws std::runtime_error that names
// what was asked for, std::bad_alloc for the host's, and for CUDA in a build without it.
namespace splatbus::device {

/// Aligned to at least 64 bytes, of no particular contents; `bytes` 0 is null. On the CPU big blocks lie on large
/// pages. On CUDA the block may be used by what is enqueued on the stream from now on; on the legacy stream, by
/// anything.
[[nodiscard]] void* allocate(StreamView stream, std::size_t bytes);
/// Behind what has been enqueued on the stream.
void deallocate(StreamView stream, void* memory) noexcept;

/// In the stream's order. With CUDA's stream: between any two devices' memory, enqueued, and pageable host memory must
/// stay until it is done. With the CPU's: within host memory.
void copy(StreamView stream, void* destination, const void* source, std::size_t bytes);
/// Sets every byte.
void fill(StreamView stream, void* memory, int value, std::size_t bytes);

}  // namespace splatbus::device

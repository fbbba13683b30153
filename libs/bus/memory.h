#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>

#include "bus/slab.h"
#include "bus/tensor.h"

namespace splatbus::bus {

/// Memory of this process, zeroed, aligned to at least 64 bytes. Throws Error, also for a kind that this build or
/// machine does not have.
[[nodiscard]] std::shared_ptr<std::byte> allocate_memory(Device kind, std::size_t bytes);

/// Bytes of that memory that nobody has at this moment; of the host's, as many as can be addressed. Throws Error.
[[nodiscard]] std::size_t free_memory(Device kind);

/// Copies between any two kinds. With device memory at either end the copy is enqueued on this thread's own stream:
/// finish_copies() waits for it. Whoever wrote the source on another stream has waited for that stream before. Throws
/// Error.
void copy_memory(void* destination, Device to, const void* source, Device from, std::size_t bytes);

/// Waits for the copies that this thread has enqueued, if any. Throws Error.
void finish_copies();

/// To be asked when work in that memory has failed: throws Error when nothing that this process does there will succeed
/// any more, as after a fault of a kernel. Then only another process can go on; slabs stay what they are.
void require_usable(Device kind);

/// Copies a tensor into memory of `kind`, tensor.bytes() of room, and waits for it. False when its slot was overwritten
/// meanwhile; the destination then holds garbage. Adds to `host_bytes` what did not stay on the device. Throws Error.
[[nodiscard]] bool copy_tensor(const TensorView& tensor, void* destination, Device kind,
                               std::atomic<std::uint64_t>& host_bytes);

}  // namespace splatbus::bus

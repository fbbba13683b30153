#pragma once

#include <array>
#include <cstddef>
#include <cstring>
#include <span>

#include "device/pinned.h"

namespace splatbus::raster::cuda {

/// Copies small tables to the device without waiting for the stream: through a ring of pinned buffers, each used again
/// when its last copy is done. Not thread-safe. Throws std::runtime_error naming the CUDA error.
class Staging {
 public:
  Staging() = default;
  ~Staging() {
    for (Entry& entry : entries_) {
      if (entry.copied != nullptr) cudaEventDestroy(entry.copied);
    }
  }
  Staging(const Staging&) = delete;
  Staging& operator=(const Staging&) = delete;

  void copy(void* device, std::span<const std::byte> host, cudaStream_t stream) {
    if (host.empty()) return;
    Entry& entry = entries_[next_];
    next_ = (next_ + 1) % entries_.size();
    if (entry.copied == nullptr) {
      device::check(cudaEventCreateWithFlags(&entry.copied, cudaEventDisableTiming), "making an event");
    } else {
      device::check(cudaEventSynchronize(entry.copied), "waiting for a copy");
    }
    entry.buffer.resize(host.size());
    std::memcpy(entry.buffer.data(), host.data(), host.size());
    device::check(cudaMemcpyAsync(device, entry.buffer.data(), host.size(), cudaMemcpyHostToDevice, stream),
                  "copying a table");
    device::check(cudaEventRecord(entry.copied, stream), "recording an event");
  }

 private:
  struct Entry {
    device::Pinned<std::byte> buffer;
    cudaEvent_t copied = nullptr;
  };
  std::array<Entry, 8> entries_;  // more than steps are on their way at once
  std::size_t next_ = 0;
};

}  // namespace splatbus::raster::cuda

#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "bus/slab.h"

namespace splatbus::bus {

/// Slabs of one device, mapped once more, one behind the other without a gap, so that data which grows slab by slab has
/// one address and is never moved. Addresses for all that may come are reserved at the start; only what is appended
/// takes memory. Keeps its slabs alive. Not thread-safe.
class SlabRange {
 public:
  /// Throws Error when the device cannot be had, or has not that many addresses.
  SlabRange(Device device, std::size_t max_bytes);
  ~SlabRange();
  SlabRange(const SlabRange&) = delete;
  SlabRange& operator=(const SlabRange&) = delete;

  /// Maps the data of a slab of one slot behind the last one's, writable where the slab is. Throws Error naming the
  /// slab when it is on another device, when its bytes are no multiple of granularity(), or when the range is full.
  void append(std::shared_ptr<Slab> slab);

  /// Of every slab's bytes.
  [[nodiscard]] std::size_t granularity() const { return granularity_; }
  [[nodiscard]] std::byte* data() const { return data_; }
  [[nodiscard]] std::size_t bytes() const { return bytes_; }
  [[nodiscard]] const std::vector<std::shared_ptr<Slab>>& slabs() const { return slabs_; }

 private:
  void reserve();
  void map(const Slab& slab, std::size_t slab_bytes);
  void release() noexcept;

  Device device_;
  std::size_t granularity_ = 4096, reserved_ = 0, bytes_ = 0;
  std::byte* data_ = nullptr;
  std::vector<std::shared_ptr<Slab>> slabs_;
  std::vector<std::uint64_t> allocations_;  ///< CUDA's handles, one a slab
};

}  // namespace splatbus::bus

#pragma once

#include <cuda_runtime_api.h>

#include <cstddef>
#include <cstdint>
#include <functional>
#include <set>
#include <utility>
#include <vector>

#include "device/buffer.h"

namespace splatbus::raster::cuda {

/// Pieces of device memory of one size from arenas that are added as more are taken and given back as
/// fewer are. Either waits for the device. Not thread-safe. Throws as device::Buffer.
class SlotPool {
 public:
  using Slot = std::uint32_t;
  static constexpr std::uint32_t kArenaSlots = 16;

  /// Gives all back; slots are of `floats` from now on.
  void reset(std::size_t floats);
  /// Of no particular contents, in the lowest arena with room.
  [[nodiscard]] Slot take();
  void give(Slot slot) { free_.insert(slot); }
  /// Gives arenas back while all that is taken fits in fewer, one of which stays as room. What it empties first it
  /// copies, and says where it is then: `moved(from, to)`.
  void shrink(cudaStream_t stream, const std::function<void(Slot, Slot)>& moved);

  [[nodiscard]] float* data(Slot slot) const {
    return arenas_[slot / kArenaSlots].data() + floats_ * (slot % kArenaSlots);
  }
  [[nodiscard]] std::size_t floats() const { return floats_; }
  [[nodiscard]] std::size_t taken() const { return arenas_.size() * kArenaSlots - free_.size(); }
  [[nodiscard]] std::size_t bytes() const { return arenas_.size() * kArenaSlots * floats_ * sizeof(float); }

 private:
  std::size_t floats_ = 0;
  std::vector<device::Buffer<float>> arenas_;
  std::set<Slot> free_;
};

}  // namespace splatbus::raster::cuda

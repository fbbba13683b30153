#include "raster/cuda/slot_pool.h"

namespace splatbus::raster::cuda {

void SlotPool::reset(std::size_t floats) {
  arenas_.clear();
  free_.clear();
  floats_ = floats;
}

SlotPool::Slot SlotPool::take() {
  if (free_.empty()) {
    const auto first = static_cast<Slot>(arenas_.size() * kArenaSlots);
    arenas_.emplace_back(kArenaSlots * floats_);
    for (Slot k = 0; k < kArenaSlots; ++k) free_.insert(free_.end(), first + k);
  }
  return free_.extract(free_.begin()).value();
}

void SlotPool::shrink(cudaStream_t stream, const std::function<void(Slot, Slot)>& moved) {
  while (free_.size() >= std::size_t{2} * kArenaSlots) {
    const auto first = static_cast<Slot>((arenas_.size() - 1) * kArenaSlots);
    for (Slot slot = first; slot < first + kArenaSlots; ++slot) {
      if (free_.erase(slot) > 0) continue;
      const Slot to = free_.extract(free_.begin()).value();
      device::copy({Device::Cuda, stream}, data(to), data(slot), floats_ * sizeof(float));
      moved(slot, to);
    }
    arenas_.pop_back();
  }
}

}  // namespace splatbus::raster::cuda

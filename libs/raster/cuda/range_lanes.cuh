#pragma once

#include <algorithm>

#include "raster/cuda/workspace.h"

namespace splatbus::raster::cuda {

/// Index of the Gaussian of a row.
__device__ inline std::uint32_t index_of_row(const ListedRange* listed, std::uint32_t row) {
  return listed == nullptr ? row : listed[row >> kPageShift].first + (row & (kPageLanes - 1));
}

/// The Gaussian of a thread, where a block takes kThreads neighbouring lanes of one listed range, or of all Gaussians
/// where the model has no ranges.
template <int kThreads>
struct Lane {
  static constexpr unsigned kBlocksPerRange = kPageLanes / kThreads;
  static_assert(kPageLanes % kThreads == 0);

  int i = 0, row = 0;
  std::uint32_t mark = 0;  ///< slot << 16 | views, in one register
  bool frozen = false;     ///< of a range that does not train: the same for the whole block

  /// It exists, and is in the frame of an object that some view has.
  [[nodiscard]] __device__ bool present() const { return slot() != kHiddenSlot; }
  /// Row of object_views.
  [[nodiscard]] __device__ int slot() const { return static_cast<int>(mark >> 16); }
  /// It may show in view b: the same for the whole block.
  [[nodiscard]] __device__ bool seen_by(int b) const { return (mark >> b & 1U) != 0; }

  /// False when the whole block has nothing to do.
  __device__ bool find(const WorkspaceView& w) {
    constexpr std::uint32_t kAllViews = 0xFFFF, kHidden = std::uint32_t{kHiddenSlot} << 16;
    bool present = false;
    if (w.listed == nullptr) {
      i = row = static_cast<int>(blockIdx.x * kThreads + threadIdx.x);
      present = i < w.count;
      mark = kAllViews;
    } else {
      const unsigned position = blockIdx.x / kBlocksPerRange, begin = blockIdx.x % kBlocksPerRange * kThreads;
      if (position >= w.counts->listed) return false;
      const ListedRange range = w.listed[position];
      if (begin >= range.count) return false;
      i = static_cast<int>(range.first + begin + threadIdx.x);
      row = static_cast<int>(position * kPageLanes + begin + threadIdx.x);
      present = begin + threadIdx.x < range.count;
      mark = range.mark;
      frozen = range.frozen != 0;
    }
    if (!present) {
      mark |= kHidden;
    } else if (w.object_slot != nullptr) {
      mark = (mark & kAllViews) | std::uint32_t{w.object_slot[i]} << 16;
    }
    return true;
  }

  /// Blocks that take all Gaussians, however many ranges are listed.
  [[nodiscard]] static unsigned blocks(const WorkspaceView& w) {
    if (w.listed == nullptr) return static_cast<unsigned>((w.count + kThreads - 1) / kThreads);
    return std::min(static_cast<unsigned>(w.range_count), w.list_capacity) * kBlocksPerRange;
  }
};

}  // namespace splatbus::raster::cuda

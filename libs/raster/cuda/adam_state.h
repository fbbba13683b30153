#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "device/buffer.h"
#include "gaussians/pages.h"
#include "raster/adam.h"
#include "raster/cuda/growing_memory.h"
#include "raster/cuda/kernels.h"
#include "raster/cuda/slot_pool.h"

namespace splatbus::raster::cuda {

/// A change of a model's structure, as whoever keeps something for each of its indices follows it.
struct ModelChange {
  /// The model's now, ascending, in host memory; none of a model without ranges, whose pages all train.
  std::span<const IndexRange> ranges;
  std::span<const IndexRange> fresh;  ///< indices that begin anew, host memory
  /// Then what was kept of from[k] is that of to[k]: device arrays without an index in common.
  const std::uint32_t* from = nullptr;
  const std::uint32_t* to = nullptr;
  std::size_t moves = 0;
};

/// Owner of what a training step keeps for each index of a model on the device: Adam's moments in blocks of a page, and
/// statistics where they are gathered. A page that is frozen has no block: of it the ages stay, and of its moments a
/// mean of the second ones a channel, as raster::Adam keeps them. All work is enqueued on the stream that is given.
/// Throws std::runtime_error naming the CUDA error.
class AdamState {
 public:
  /// Everything begins anew.
  void reset(const ParameterLayout& layout, int count, std::span<const IndexRange> ranges, cudaStream_t stream);
  /// To `count` indices. Those that are new begin anew.
  void follow(int count, const ModelChange& change, float beta2, cudaStream_t stream);
  /// Begins to gather statistics, or gives their memory back.
  void gather_statistics(bool gather, cudaStream_t stream);
  void clear_statistics(cudaStream_t stream);

  /// As raster::Adam's. Copies are enqueued: `moments`, in host memory, stays until the stream is done.
  [[nodiscard]] PageMoments moments_of(std::size_t page) const;
  void save(std::size_t page, float* moments, cudaStream_t stream) const;
  /// Nothing where the page is not of that kind.
  void restore(std::size_t page, PageMoments kind, const float* moments, cudaStream_t stream);

  [[nodiscard]] OptimizerState view() const { return {.blocks = table_.data(), .channels = layout_.channels()}; }
  /// Null where they are not gathered.
  [[nodiscard]] ScreenStatistics statistics() const {
    return {.mean2d_norm = reinterpret_cast<float*>(mean2d_norm_.data()),
            .steps = reinterpret_cast<std::uint32_t*>(mean2d_steps_.data())};
  }
  [[nodiscard]] std::size_t bytes() const {
    return blocks_.bytes() + rests_.bytes() + mean2d_norm_.bytes() + mean2d_steps_.bytes();
  }
  /// Of the blocks that pages have.
  [[nodiscard]] std::size_t block_bytes() const { return blocks_.taken() * blocks_.floats() * sizeof(float); }

 private:
  static constexpr std::size_t kMaxIndices = std::size_t{1} << 26U;

  struct Page {
    std::optional<SlotPool::Slot> block, rest;
  };
  enum class PageState : std::uint8_t { Absent, Frozen, Trains };

  [[nodiscard]] std::size_t channels() const { return static_cast<std::size_t>(layout_.channels()); }
  [[nodiscard]] std::size_t rows() const { return 2 * channels() + OptimizerState::kCounters; }
  [[nodiscard]] std::vector<PageState> states_of(std::size_t count, std::span<const IndexRange> ranges) const;
  void grow(std::size_t count, cudaStream_t stream);
  void take_blocks(const std::vector<PageState>& states, std::span<const IndexRange> fresh, float beta2,
                   cudaStream_t stream);
  void give_blocks(const std::vector<PageState>& states, float beta2, cudaStream_t stream);
  void upload_table(cudaStream_t stream);
  void forget(std::size_t first, std::size_t count, cudaStream_t stream);
  void move(const ModelChange& change, cudaStream_t stream);

  ParameterLayout layout_;
  int count_ = 0;
  bool gathers_ = false;
  std::vector<Page> pages_;
  SlotPool blocks_, rests_;
  device::Buffer<float*> table_;  ///< of each page's block
  std::vector<float*> host_table_;
  device::Buffer<std::byte> places_;  ///< kernels' arguments
  GrowingMemory mean2d_norm_{kMaxIndices * sizeof(float)}, mean2d_steps_{kMaxIndices * sizeof(std::uint32_t)};
};

}  // namespace splatbus::raster::cuda

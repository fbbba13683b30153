#pragma once

#include <cstdint>

#include "raster/cuda/growing_memory.h"
#include "raster/cuda/kernels.h"

namespace splatbus::raster::cuda {

/// Owner of what a training step keeps for each index of a model on the device: Adam's moments in blocks of a page, and
/// statistics where they are gathered. It grows without a copy. All work is enqueued on the stream that is given.
/// Throws std::runtime_error naming the CUDA error.
class AdamState {
 public:
  /// Everything begins anew.
  void reset(const ParameterLayout& layout, int count, cudaStream_t stream);
  /// Indices below both counts stay as they are, all others begin anew.
  void resize(int count, cudaStream_t stream);
  /// Indices first, first + 1, ... begin anew.
  void forget(int first, int count, cudaStream_t stream);
  /// What was kept of from[k] is that of to[k]; device arrays without an index in common.
  void move(const std::uint32_t* from, const std::uint32_t* to, int count, cudaStream_t stream);
  /// Begins to gather statistics, or gives their memory back.
  void gather_statistics(bool gather, cudaStream_t stream);
  void clear_statistics(cudaStream_t stream);

  [[nodiscard]] OptimizerState view() const {
    return {.blocks = reinterpret_cast<float*>(moments_.data()), .channels = layout_.channels()};
  }
  /// Null where they are not gathered.
  [[nodiscard]] ScreenStatistics statistics() const {
    return {.mean2d_norm = reinterpret_cast<float*>(mean2d_norm_.data()),
            .steps = reinterpret_cast<std::uint32_t*>(mean2d_steps_.data())};
  }
  [[nodiscard]] std::size_t bytes() const { return moments_.bytes() + mean2d_norm_.bytes() + mean2d_steps_.bytes(); }

 private:
  static constexpr std::size_t kMaxIndices = std::size_t{1} << kPatchShift;
  static constexpr std::size_t kMaxRows =
      2 * ParameterLayout{Appearance::Radiance, 3}.channels() + OptimizerState::kCounters;

  [[nodiscard]] std::size_t rows() const {
    return 2 * static_cast<std::size_t>(layout_.channels()) + OptimizerState::kCounters;
  }
  void grow(cudaStream_t stream);

  ParameterLayout layout_;
  int count_ = 0;
  bool gathers_ = false;
  GrowingMemory moments_{kMaxIndices * kMaxRows * sizeof(float)};
  GrowingMemory mean2d_norm_{kMaxIndices * sizeof(float)}, mean2d_steps_{kMaxIndices * sizeof(std::uint32_t)};
};

}  // namespace splatbus::raster::cuda

#pragma once

#include <cstdint>

#include "device/buffer.h"
#include "raster/cuda/kernels.h"

namespace splatbus::raster::cuda {

/// Owner of Adam's moments of a model on the device, planes [channels][stride] beside the model's. All work is enqueued
/// on the stream that is given. Throws std::runtime_error naming the CUDA error.
class AdamState {
 public:
  /// Everything begins anew.
  void reset(const ParameterLayout& layout, int count, std::int64_t stride, cudaStream_t stream);
  /// Columns below both counts stay as they are, all others begin anew. Only a change of stride allocates, and waits.
  void resize(int count, std::int64_t stride, cudaStream_t stream);
  /// Column from[k] replaces column to[k]; device arrays without an index in common.
  void move(const std::uint32_t* from, const std::uint32_t* to, int count, cudaStream_t stream);

  [[nodiscard]] OptimizerState view() const {
    return {.first = first_.data(), .second = second_.data(), .steps = steps_.data()};
  }
  [[nodiscard]] std::size_t bytes() const { return (first_.size() + second_.size() + steps_.size()) * sizeof(float); }

 private:
  void clear_columns(int begin, int end, cudaStream_t stream);

  ParameterLayout layout_;
  int count_ = 0;
  std::int64_t stride_ = 0;
  device::Buffer<float> first_, second_;
  device::Buffer<std::uint32_t> steps_;
};

}  // namespace splatbus::raster::cuda

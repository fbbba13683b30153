#pragma once

#include <cuda_runtime_api.h>

#include <cstdint>

#include "device/buffer.h"

namespace splatbus::raster::cuda {

/// Owner of planes [channels][stride] on the device, with columns beside a model's; columns that are new are zero. All
/// work is enqueued on the stream that is given. For float and std::uint32_t. Throws std::runtime_error naming the CUDA
/// error.
template <class T>
class ColumnPlanes {
 public:
  /// All columns are new.
  void reset(int channels, int count, std::int64_t stride, cudaStream_t stream);
  /// The same with another stride: columns below both counts as they are here, all others new.
  [[nodiscard]] ColumnPlanes restrided(int count, std::int64_t stride, cudaStream_t stream) const;
  /// Columns below both counts stay as they are. The stride does not change.
  void resize(int count, cudaStream_t stream);
  /// Column from[k] replaces column to[k]; device arrays without an index in common.
  void move(const std::uint32_t* from, const std::uint32_t* to, int count, cudaStream_t stream);
  void clear(cudaStream_t stream);

  [[nodiscard]] T* data() const { return planes_.data(); }
  [[nodiscard]] std::int64_t stride() const { return stride_; }
  [[nodiscard]] std::size_t bytes() const { return planes_.size() * sizeof(T); }

 private:
  void clear_columns(int begin, int end, cudaStream_t stream);

  int channels_ = 0, count_ = 0;
  std::int64_t stride_ = 0;
  device::Buffer<T> planes_;
};

}  // namespace splatbus::raster::cuda

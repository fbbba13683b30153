#include <algorithm>

#include "device/check.h"
#include "raster/cuda/column_planes.h"
#include "raster/cuda/gaussian_channels.cuh"

namespace splatbus::raster::cuda {
namespace {

using device::check;

constexpr int kThreads = 256;

/// One thread a column and plane.
template <class T>
__global__ void move_columns_kernel(T* planes, std::int64_t stride, const std::uint32_t* from, const std::uint32_t* to,
                                    int count) {
  const int k = blockIdx.x * kThreads + threadIdx.x;
  if (k >= count) return;
  const Channels<T> channels{planes, stride};
  const auto channel = static_cast<int>(blockIdx.y);
  channels(channel, static_cast<int>(to[k])) = channels(channel, static_cast<int>(from[k]));
}

}  // namespace

template <class T>
void ColumnPlanes<T>::reset(int channels, int count, std::int64_t stride, cudaStream_t stream) {
  channels_ = channels;
  count_ = count;
  stride_ = stride;
  planes_.resize(static_cast<std::size_t>(channels) * static_cast<std::size_t>(stride));
  clear(stream);
}

template <class T>
ColumnPlanes<T> ColumnPlanes<T>::restrided(int count, std::int64_t stride, cudaStream_t stream) const {
  ColumnPlanes moved;
  moved.reset(channels_, count, stride, stream);
  const int kept = std::min(count, count_);
  if (kept > 0 && channels_ > 0) {
    check(cudaMemcpy2DAsync(moved.planes_.data(), static_cast<std::size_t>(stride) * sizeof(T), planes_.data(),
                            static_cast<std::size_t>(stride_) * sizeof(T), static_cast<std::size_t>(kept) * sizeof(T),
                            static_cast<std::size_t>(channels_), cudaMemcpyDeviceToDevice, stream),
          "moving columns");
  }
  return moved;
}

template <class T>
void ColumnPlanes<T>::resize(int count, cudaStream_t stream) {
  // Columns that come back after a shrink begin anew.
  clear_columns(count, count_, stream);
  count_ = count;
}

template <class T>
void ColumnPlanes<T>::move(const std::uint32_t* from, const std::uint32_t* to, int count, cudaStream_t stream) {
  if (count == 0 || channels_ == 0) return;
  const dim3 blocks(static_cast<unsigned>((count + kThreads - 1) / kThreads), static_cast<unsigned>(channels_));
  move_columns_kernel<<<blocks, kThreads, 0, stream>>>(planes_.data(), stride_, from, to, count);
  check(cudaGetLastError(), "moving columns");
}

template <class T>
void ColumnPlanes<T>::clear(cudaStream_t stream) {
  if (planes_.size() > 0) planes_.clear(stream);
}

template <class T>
void ColumnPlanes<T>::clear_columns(int begin, int end, cudaStream_t stream) {
  if (begin >= end || channels_ == 0) return;
  const std::size_t pitch = static_cast<std::size_t>(stride_) * sizeof(T);
  const std::size_t width = static_cast<std::size_t>(end - begin) * sizeof(T);
  check(cudaMemset2DAsync(planes_.data() + begin, pitch, 0, width, static_cast<std::size_t>(channels_), stream),
        "clearing columns");
}

template class ColumnPlanes<float>;
template class ColumnPlanes<std::uint32_t>;

}  // namespace splatbus::raster::cuda

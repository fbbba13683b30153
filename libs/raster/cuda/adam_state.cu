#include <algorithm>
#include <utility>

#include "raster/cuda/adam_state.h"

namespace splatbus::raster::cuda {
namespace {

constexpr int kThreads = 256;

/// One thread a column and plane; the last row of blocks moves the step counts.
__global__ void move_columns_kernel(OptimizerState state, int channels, std::int64_t stride, const std::uint32_t* from,
                                    const std::uint32_t* to, int count) {
  const int k = blockIdx.x * kThreads + threadIdx.x;
  const int channel = blockIdx.y;
  if (k >= count) return;
  if (channel == channels) {
    state.steps[to[k]] = state.steps[from[k]];
    return;
  }
  const std::int64_t plane = channel * stride;
  state.first[plane + to[k]] = state.first[plane + from[k]];
  state.second[plane + to[k]] = state.second[plane + from[k]];
}

template <class T>
void clear_plane_columns(T* planes, std::size_t channels, std::int64_t stride, int begin, int end,
                         cudaStream_t stream) {
  if (begin >= end) return;
  const std::size_t pitch = static_cast<std::size_t>(stride) * sizeof(T);
  const std::size_t width = static_cast<std::size_t>(end - begin) * sizeof(T);
  check(cudaMemset2DAsync(planes + begin, pitch, 0, width, channels, stream), "clearing Adam's moments");
}

/// A buffer of `channels` planes with another stride that holds the first `kept` columns of `planes`, all else zero.
template <class T>
device::Buffer<T> restrided(const device::Buffer<T>& planes, std::size_t channels, std::int64_t old_stride,
                            std::int64_t stride, int kept, cudaStream_t stream) {
  device::Buffer<T> moved(channels * static_cast<std::size_t>(stride));
  moved.clear(stream);
  if (kept > 0) {
    check(cudaMemcpy2DAsync(moved.data(), static_cast<std::size_t>(stride) * sizeof(T), planes.data(),
                            static_cast<std::size_t>(old_stride) * sizeof(T),
                            static_cast<std::size_t>(kept) * sizeof(T), channels, cudaMemcpyDeviceToDevice, stream),
          "moving Adam's moments");
  }
  return moved;
}

}  // namespace

void AdamState::reset(const ParameterLayout& layout, int count, std::int64_t stride, cudaStream_t stream) {
  layout_ = layout;
  count_ = count;
  stride_ = stride;
  const auto elements = static_cast<std::size_t>(layout.channels()) * static_cast<std::size_t>(stride);
  first_.resize(elements);
  second_.resize(elements);
  steps_.resize(static_cast<std::size_t>(stride));
  first_.clear(stream);
  second_.clear(stream);
  steps_.clear(stream);
}

void AdamState::resize(int count, std::int64_t stride, cudaStream_t stream) {
  const auto channels = static_cast<std::size_t>(layout_.channels());
  if (stride != stride_) {
    const int kept = std::min(count, count_);
    // All of them or, when memory runs out, none.
    auto first = restrided(first_, channels, stride_, stride, kept, stream);
    auto second = restrided(second_, channels, stride_, stride, kept, stream);
    auto steps = restrided(steps_, 1, stride_, stride, kept, stream);
    check(cudaStreamSynchronize(stream), "moving Adam's moments");
    first_ = std::move(first);
    second_ = std::move(second);
    steps_ = std::move(steps);
    stride_ = stride;
  } else {
    // Columns that come back after a shrink begin anew.
    clear_columns(count, count_, stream);
  }
  count_ = count;
}

void AdamState::clear_columns(int begin, int end, cudaStream_t stream) {
  const auto channels = static_cast<std::size_t>(layout_.channels());
  clear_plane_columns(first_.data(), channels, stride_, begin, end, stream);
  clear_plane_columns(second_.data(), channels, stride_, begin, end, stream);
  clear_plane_columns(steps_.data(), 1, stride_, begin, end, stream);
}

void AdamState::move(const std::uint32_t* from, const std::uint32_t* to, int count, cudaStream_t stream) {
  if (count == 0) return;
  const dim3 blocks(static_cast<unsigned>((count + kThreads - 1) / kThreads),
                    static_cast<unsigned>(layout_.channels() + 1));
  move_columns_kernel<<<blocks, kThreads, 0, stream>>>(view(), layout_.channels(), stride_, from, to, count);
  check(cudaGetLastError(), "moving Adam's moments");
}

}  // namespace splatbus::raster::cuda

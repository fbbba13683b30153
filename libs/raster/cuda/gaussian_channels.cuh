#pragma once

#include <cstdint>

#include "raster/cuda/device_scene.h"

// How the channels of Gaussians lie in device memory, [channels][stride], for all Gaussians or page by page. Kernels
// reach every channel through these, so that this header alone knows.
namespace splatbus::raster::cuda {

/// The same value, but the compiler does not know: it then computes the addresses of a Gaussian's many channels where
/// they are used, instead of keeping them all in registers, and spilling them.
template <class T>
__device__ inline T recomputed(T value) {
  if constexpr (sizeof(T) == 8) {
    asm volatile("" : "+l"(value));
  } else {
    asm volatile("" : "+r"(value));
  }
  return value;
}

/// Some neighbouring channels of one Gaussian.
template <class T>
struct ChannelsOfOne {
  T* first;
  std::int64_t pitch;

  __device__ T& operator[](int channel) const { return first[channel * pitch]; }
  [[nodiscard]] __device__ ChannelsOfOne recomputed() const { return {cuda::recomputed(first), pitch}; }
};

/// Of Gaussian `i` from where a channel of 4-byte elements begins.
__device__ inline std::int64_t index_offset(int i, std::uint32_t page_shift, std::int64_t page_stride) {
  const auto index = static_cast<std::uint32_t>(i);
  return (index >> page_shift) * page_stride + (index & ((1U << page_shift) - 1));
}
__device__ inline std::int64_t index_offset(int i, const DeviceGaussians& g) {
  return index_offset(i, g.page_shift, g.page_stride);
}

/// Channels of all Gaussians: a model's parameters, or what is kept beside them.
template <class T>
struct Channels {
  T* data;
  std::int64_t stride;
  std::uint32_t page_shift = kNoPages;
  std::int64_t page_stride = 0;

  /// In elements from `data`; the same in every array that lies beside the model's.
  [[nodiscard]] __device__ std::int64_t offset(int channel, int i) const {
    return channel * stride + index_offset(i, page_shift, page_stride);
  }
  __device__ T& operator()(int channel, int i) const { return data[offset(channel, i)]; }
  /// Of Gaussian `i`, from channel `first` on.
  [[nodiscard]] __device__ ChannelsOfOne<T> of(int i, int first = 0) const { return {data + offset(first, i), stride}; }
};

__device__ inline Channels<float> parameters_of(const DeviceGaussians& g) {
  return {g.parameters, g.stride, g.page_shift, g.page_stride};
}
__device__ inline Channels<const float> normals_of(const DeviceGaussians& g) {
  return {g.normal, g.stride, g.page_shift, g.page_stride};
}
/// Sun visibility in a view, 1 where neither view nor model has any.
__device__ inline float visibility_of(const DeviceGaussians& g, const DeviceView& view, int i) {
  if (view.visibility != nullptr) return (1.0F / 255) * static_cast<float>(view.visibility[i]);
  return g.visibility != nullptr ? g.visibility[index_offset(i, g)] : 1.0F;
}
__device__ inline bool is_frozen(const DeviceGaussians& g, int i) {
  return g.flags != nullptr && (g.flags[index_offset(i, g)] & kFrozen) != 0;
}

}  // namespace splatbus::raster::cuda

#include <thrust/iterator/counting_iterator.h>

#include <cub/device/device_select.cuh>

#include "device/check.h"
#include "trainer/cuda/column_kernels.h"

namespace splatbus::trainer::cuda {

namespace {

constexpr int kThreads = 256;
constexpr int kPlanesBesides = 10;  // that copy_one copies after parameters and average

unsigned blocks_for(std::uint32_t count) {
  return (count + kThreads - 1) / kThreads;
}

__device__ std::uint32_t thread_index() {
  return blockIdx.x * kThreads + threadIdx.x;
}

/// Copies a column's value in plane number `plane`, but for logit and id, which come by themselves.
__device__ void copy_one(const ModelPlanes& p, int plane, std::uint32_t from, std::uint32_t to) {
  const int channels = p.layout.channels();
  const auto copy = [&](auto* planes, int channel) {
    planes[channel * p.capacity + to] = planes[channel * p.capacity + from];
  };
  if (plane < channels) {
    if (plane != ParameterLayout::kOpacityLogit) copy(p.parameters, plane);
    return;
  }
  plane -= channels;
  if (plane < channels) return copy(p.average, plane);
  plane -= channels;
  if (plane < 3) return copy(p.normal, plane);
  if (plane < 6) return copy(p.surface_point, plane - 3);
  if (plane == 6) return copy(p.visibility, 0);
  if (plane == 7) return copy(p.object_id, 0);
  if (plane == 8) return copy(p.flags, 0);
  copy(p.cell, 0);
}

__global__ void hide_columns(ModelPlanes p, const std::uint32_t* to, std::uint32_t count, float invisible_logit) {
  const std::uint32_t k = thread_index();
  if (k < count) p.parameters[ParameterLayout::kOpacityLogit * p.capacity + to[k]] = invisible_logit;
}

__global__ void copy_planes(ModelPlanes p, const std::uint32_t* from, const std::uint32_t* to, std::uint32_t count) {
  const std::uint32_t k = thread_index();
  if (k < count) copy_one(p, static_cast<int>(blockIdx.y), from[k], to[k]);
}

__global__ void copy_ids(ModelPlanes p, const std::uint32_t* from, const std::uint32_t* to, std::uint32_t count) {
  const std::uint32_t k = thread_index();
  if (k < count) p.gaussian_id[to[k]] = p.gaussian_id[from[k]];
}

__global__ void show_columns(ModelPlanes p, const std::uint32_t* from, const std::uint32_t* to, std::uint32_t count) {
  const std::uint32_t k = thread_index();
  float* const logits = p.parameters + ParameterLayout::kOpacityLogit * p.capacity;
  if (k < count) logits[to[k]] = logits[from[k]];
}

__global__ void number_columns(ModelPlanes p, std::uint32_t first, std::uint32_t count, std::uint64_t first_id) {
  const std::uint32_t k = thread_index();
  if (k < count) p.gaussian_id[first + k] = first_id + k;
}

/// Adds how many threads of the block say yes; all of them call it.
__device__ void count_in(std::uint32_t* counter, bool yes) {
  const int in_block = __syncthreads_count(yes ? 1 : 0);
  if (threadIdx.x == 0 && in_block > 0) atomicAdd(counter, static_cast<std::uint32_t>(in_block));
}

__global__ void count_marks(const std::uint8_t* marks, std::uint32_t count, std::uint32_t* counter) {
  const std::uint32_t i = thread_index();
  count_in(counter, i < count && marks[i] != 0);
}

__global__ void set_visibility(ModelPlanes p, const float* values, std::uint32_t count) {
  const std::uint32_t i = thread_index();
  if (i < count) p.visibility[i] = values[i] >= 0 ? fminf(values[i], 1.0F) : 0.0F;  // 0 for what is not a number
}

__global__ void find_broken(ModelPlanes p, std::uint32_t count, float invisible_logit, std::uint8_t* broken) {
  const std::uint32_t i = thread_index();
  if (i >= count) return;
  bool finite = true;
  const auto look = [&](const float* planes, int channels) {
    for (int c = 0; c < channels; ++c) finite = finite && isfinite(planes[c * p.capacity + i]);
  };
  look(p.parameters, p.layout.channels());
  look(p.average, p.layout.channels());
  look(p.normal, 3);
  look(p.surface_point, 3);
  look(p.visibility, 1);
  const bool left = p.parameters[ParameterLayout::kOpacityLogit * p.capacity + i] < invisible_logit;
  broken[i] = left || !finite ? 1 : 0;
}

struct HasMark {
  const std::uint8_t* marks;
  bool set;
  __device__ bool operator()(std::uint32_t column) const { return (marks[column] != 0) == set; }
};

void launched(const char* what) {
  device::check(cudaGetLastError(), what);
}

}  // namespace

void launch_copy_columns(const ModelPlanes& planes, const std::uint32_t* from, const std::uint32_t* to,
                         std::uint32_t count, float invisible_logit, cudaStream_t stream) {
  if (count == 0) return;
  const unsigned blocks = blocks_for(count);
  const auto plane_count = static_cast<unsigned>(2 * planes.layout.channels() + kPlanesBesides);
  hide_columns<<<blocks, kThreads, 0, stream>>>(planes, to, count, invisible_logit);
  copy_planes<<<dim3(blocks, plane_count), kThreads, 0, stream>>>(planes, from, to, count);
  copy_ids<<<blocks, kThreads, 0, stream>>>(planes, from, to, count);
  show_columns<<<blocks, kThreads, 0, stream>>>(planes, from, to, count);
  launched("moving columns");
}

void launch_number_columns(const ModelPlanes& planes, std::uint32_t first, std::uint32_t count, std::uint64_t first_id,
                           cudaStream_t stream) {
  if (count == 0) return;
  number_columns<<<blocks_for(count), kThreads, 0, stream>>>(planes, first, count, first_id);
  launched("numbering columns");
}

void launch_count_marks(const std::uint8_t* marks, std::uint32_t count, std::uint32_t* counter, cudaStream_t stream) {
  if (count == 0) return;
  count_marks<<<blocks_for(count), kThreads, 0, stream>>>(marks, count, counter);
  launched("counting marks");
}

std::size_t list_columns_scratch_bytes(std::uint32_t count) {
  std::size_t bytes = 0;
  device::check(cub::DeviceSelect::If(nullptr, bytes, thrust::counting_iterator<std::uint32_t>(0),
                                      static_cast<std::uint32_t*>(nullptr), static_cast<std::uint32_t*>(nullptr),
                                      static_cast<int>(count), HasMark{}),
                "asking for scratch");
  return bytes;
}

void launch_list_columns(const std::uint8_t* marks, bool set, std::uint32_t begin, std::uint32_t end,
                         std::uint32_t* columns, std::uint32_t* listed, void* scratch, std::size_t scratch_bytes,
                         cudaStream_t stream) {
  device::check(
      cub::DeviceSelect::If(scratch, scratch_bytes, thrust::counting_iterator<std::uint32_t>(begin), columns, listed,
                            static_cast<int>(end - begin), HasMark{.marks = marks, .set = set}, stream),
      "listing columns");
}

void launch_set_visibility(const ModelPlanes& planes, const float* values, std::uint32_t count, cudaStream_t stream) {
  if (count == 0) return;
  set_visibility<<<blocks_for(count), kThreads, 0, stream>>>(planes, values, count);
  launched("setting visibility");
}

void launch_find_broken(const ModelPlanes& planes, std::uint32_t count, float invisible_logit, std::uint8_t* broken,
                        cudaStream_t stream) {
  if (count == 0) return;
  find_broken<<<blocks_for(count), kThreads, 0, stream>>>(planes, count, invisible_logit, broken);
  launched("inspecting columns");
}

}  // namespace splatbus::trainer::cuda

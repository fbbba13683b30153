#include <thrust/iterator/counting_iterator.h>

#include <cub/device/device_select.cuh>

#include "device/check.h"
#include "trainer/cuda/insert_kernels.h"
#include "trainer/insert_rows.h"

namespace splatbus::trainer::cuda {

namespace {

constexpr int kThreads = 256;

unsigned blocks_for(std::uint32_t rows) {
  return (rows + kThreads - 1) / kThreads;
}

template <int kChannels>
__device__ void load(const float* planes, std::int64_t stride, std::uint32_t row, float (&values)[kChannels]) {
#pragma unroll
  for (int c = 0; c < kChannels; ++c) values[c] = planes[c * stride + row];
}

template <int kChannels>
__device__ bool all_below(const float (&values)[kChannels], float limit) {
  bool below = true;
#pragma unroll
  for (int c = 0; c < kChannels; ++c) below = below && fabsf(values[c]) <= limit;  // false when it is NaN
  return below;
}

template <int kChannels>
__device__ float length(const float (&values)[kChannels]) {
  float sum = 0;
#pragma unroll
  for (int c = 0; c < kChannels; ++c) sum += values[c] * values[c];
  return sqrtf(sum);
}

__global__ void mark_valid(InsertRows from, std::uint32_t rows, std::uint8_t* valid) {
  const std::uint32_t row = blockIdx.x * kThreads + threadIdx.x;
  if (row >= rows) return;
  float mean[3], log_scale[3], rotation[4], opacity_logit[1], albedo[3], normal[3], visibility[1];
  load(from.mean, from.stride, row, mean);
  load(from.log_scale, from.stride, row, log_scale);
  load(from.rotation, from.stride, row, rotation);
  load(from.opacity_logit, from.stride, row, opacity_logit);
  load(from.albedo, from.stride, row, albedo);
  load(from.normal, from.stride, row, normal);
  load(from.visibility, from.stride, row, visibility);
  const bool sound = all_below(mean, kMaxDistance_m) && all_below(log_scale, kMaxAnyLogScale) &&
                     all_below(rotation, kMaxAny) && all_below(opacity_logit, kMaxAny) && all_below(albedo, kMaxAny) &&
                     all_below(visibility, kMaxAny) && all_below(normal, kMaxAnyNormal);
  const bool directed = length(rotation) > kMinRotationLength && fabsf(length(normal) - 1.0F) <= kUnitTolerance;
  valid[row] = sound && directed ? 1 : 0;
}

template <int kChannels>
__device__ void store(const float* planes, std::int64_t stride, std::uint32_t row, const float (&values)[kChannels]) {
  auto* const to = const_cast<float*>(planes);  // the rows that are written are this batch's own
#pragma unroll
  for (int c = 0; c < kChannels; ++c) to[c * stride + row] = values[c];
}

template <int kChannels>
__device__ void normalise(float (&values)[kChannels]) {
  const float inverse = 1.0F / length(values);
#pragma unroll
  for (int c = 0; c < kChannels; ++c) values[c] *= inverse;
}

template <int kChannels>
__device__ void clamp(float (&values)[kChannels], float low, float high) {
#pragma unroll
  for (int c = 0; c < kChannels; ++c) values[c] = fminf(fmaxf(values[c], low), high);
}

__global__ void gather(InsertRows from, const std::uint32_t* keep, const std::uint32_t* kept, InsertRows to) {
  const std::uint32_t i = blockIdx.x * kThreads + threadIdx.x;
  if (i >= *kept) return;
  const std::uint32_t row = keep[i];
  float three[3], four[4], one[1];
  load(from.mean, from.stride, row, three);
  store(to.mean, to.stride, i, three);
  load(from.log_scale, from.stride, row, three);
  clamp(three, kMinLogScale, kMaxLogScale);
  store(to.log_scale, to.stride, i, three);
  load(from.rotation, from.stride, row, four);
  normalise(four);
  store(to.rotation, to.stride, i, four);
  load(from.opacity_logit, from.stride, row, one);
  clamp(one, -kMaxOpacityLogit, kMaxOpacityLogit);
  store(to.opacity_logit, to.stride, i, one);
  load(from.albedo, from.stride, row, three);
  clamp(three, 0.0F, 1.0F);
  store(to.albedo, to.stride, i, three);
  load(from.normal, from.stride, row, three);
  normalise(three);
  store(to.normal, to.stride, i, three);
  load(from.visibility, from.stride, row, one);
  clamp(one, 0.0F, 1.0F);
  store(to.visibility, to.stride, i, one);
  const_cast<std::uint32_t*>(to.object_id)[i] = from.object_id[row];
  const_cast<std::uint64_t*>(to.cell)[i] = from.cell[row];
}

}  // namespace

std::size_t valid_rows_scratch_bytes(std::uint32_t rows) {
  std::size_t bytes = 0;
  device::check(
      cub::DeviceSelect::Flagged(nullptr, bytes, thrust::counting_iterator<std::uint32_t>(0),
                                 static_cast<const std::uint8_t*>(nullptr), static_cast<std::uint32_t*>(nullptr),
                                 static_cast<std::uint32_t*>(nullptr), static_cast<int>(rows)),
      "asking for scratch");
  return bytes;
}

void launch_find_valid_rows(const InsertRows& from, std::uint32_t rows, std::uint8_t* valid, std::uint32_t* keep,
                            std::uint32_t* kept, void* scratch, std::size_t scratch_bytes, cudaStream_t stream) {
  mark_valid<<<blocks_for(rows), kThreads, 0, stream>>>(from, rows, valid);
  device::check(cudaGetLastError(), "checking inserted rows");
  device::check(cub::DeviceSelect::Flagged(scratch, scratch_bytes, thrust::counting_iterator<std::uint32_t>(0), valid,
                                           keep, kept, static_cast<int>(rows), stream),
                "selecting inserted rows");
}

void launch_gather_rows(const InsertRows& from, std::uint32_t rows, const std::uint32_t* keep,
                        const std::uint32_t* kept, const InsertRows& to, cudaStream_t stream) {
  gather<<<blocks_for(rows), kThreads, 0, stream>>>(from, keep, kept, to);
  device::check(cudaGetLastError(), "gathering inserted rows");
}

}  // namespace splatbus::trainer::cuda

#include <thrust/random.h>

#include "device/check.h"
#include "gaussians/layout.h"
#include "trainer/cuda/densify_kernels.h"

namespace splatbus::trainer::cuda {

namespace {

constexpr int kThreads = 256;

unsigned blocks_for(std::uint32_t count) {
  return (count + kThreads - 1) / kThreads;
}

__global__ void choose_dense(ModelPlanes p, raster::cuda::ScreenStatistics statistics, std::uint32_t count,
                             float threshold, std::uint8_t* chosen) {
  const std::uint32_t i = blockIdx.x * kThreads + threadIdx.x;
  if (i >= count) return;
  const std::uint32_t steps = statistics.steps[i];
  chosen[i] = steps > 0 && statistics.mean2d_norm[i] / static_cast<float>(steps) >= threshold ? 1 : 0;
}

/// Rotates by a unit quaternion.
__device__ float3 rotated(float4 q, float3 v) {  // w x y z
  const float3 axis = make_float3(q.y, q.z, q.w);
  const auto cross = [](float3 a, float3 b) {
    return make_float3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
  };
  const float3 t = cross(axis, v), u = cross(axis, t);
  return make_float3(v.x + 2.0F * (q.x * t.x + u.x), v.y + 2.0F * (q.x * t.y + u.y), v.z + 2.0F * (q.x * t.z + u.z));
}

/// Moves a Gaussian to a place drawn from it, and makes it smaller.
__device__ void sample_split(const ModelPlanes& p, std::uint32_t column, float log_split_factor,
                             thrust::minstd_rand& random) {
  thrust::normal_distribution<float> normal;

  float* const at = p.parameters + column;
  float* const scale = at + ParameterLayout::kLogScale * p.capacity;
  const float* const q = at + ParameterLayout::kRotation * p.capacity;
  float local[3];
  for (int axis = 0; axis < 3; ++axis) {
    local[axis] = normal(random) * expf(scale[axis * p.capacity]);
    scale[axis * p.capacity] -= log_split_factor;
  }
  const float4 stored = make_float4(q[0], q[p.capacity], q[2 * p.capacity], q[3 * p.capacity]);
  const float inv = rsqrtf(stored.x * stored.x + stored.y * stored.y + stored.z * stored.z + stored.w * stored.w);
  const float3 offset = rotated(make_float4(stored.x * inv, stored.y * inv, stored.z * inv, stored.w * inv),
                                make_float3(local[0], local[1], local[2]));
  at[0] += offset.x;
  at[p.capacity] += offset.y;
  at[2 * p.capacity] += offset.z;
}

__global__ void split(ModelPlanes p, const std::uint32_t* columns, std::uint32_t first, std::uint32_t count,
                      SplitOptions options) {
  const std::uint32_t k = blockIdx.x * kThreads + threadIdx.x;
  if (k >= count) return;
  const float* const scale = p.parameters + ParameterLayout::kLogScale * p.capacity + columns[k];
  const float largest = fmaxf(scale[0], fmaxf(scale[p.capacity], scale[2 * p.capacity]));
  if (largest <= options.max_clone_log_scale) return;
  thrust::minstd_rand random(options.seed);
  random.discard(6ULL * k);
  sample_split(p, columns[k], options.log_split_factor, random);
  sample_split(p, first + k, options.log_split_factor, random);
}

}  // namespace

void launch_choose_dense(const ModelPlanes& planes, const raster::cuda::ScreenStatistics& statistics,
                         std::uint32_t count, float threshold, std::uint8_t* chosen, cudaStream_t stream) {
  if (count == 0) return;
  choose_dense<<<blocks_for(count), kThreads, 0, stream>>>(planes, statistics, count, threshold, chosen);
  device::check(cudaGetLastError(), "choosing Gaussians to clone");
}

void launch_split(const ModelPlanes& planes, const std::uint32_t* columns, std::uint32_t first, std::uint32_t count,
                  const SplitOptions& options, cudaStream_t stream) {
  if (count == 0) return;
  split<<<blocks_for(count), kThreads, 0, stream>>>(planes, columns, first, count, options);
  device::check(cudaGetLastError(), "splitting Gaussians");
}

}  // namespace splatbus::trainer::cuda

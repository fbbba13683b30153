#include "device/check.h"
#include "raster/cuda/gaussian_channels.cuh"
#include "trainer/cuda/step_kernels.h"

namespace splatbus::trainer::cuda {
namespace {

using device::check;
using raster::cuda::Channels;
using raster::cuda::ChannelsOfOne;

constexpr int kThreads = 256;

unsigned blocks_for(int count) {
  return static_cast<unsigned>((count + kThreads - 1) / kThreads);
}

/// A thread a column; a row of blocks takes kChannels channels, so that loads overlap.
constexpr int kChannels = 8;

__global__ void average_kernel(Columns c, AverageOptions options) {
  const int i = options.begin + static_cast<int>(blockIdx.x) * kThreads + static_cast<int>(threadIdx.x);
  if (i >= options.end) return;
  const std::uint64_t born = c.birth[i], age = options.step > born ? options.step - born : 0;
  float share = 1.0F;
  if (age > 0) {
    share = fmaxf(options.settled_share, fminf(1.0F, 4.0F * options.stripes / static_cast<float>(age)));
  }
  const int first = static_cast<int>(blockIdx.y) * kChannels;
  const Channels<float> parameters{c.parameters, c.stride}, averages{c.average, c.stride};
  float live[kChannels], average[kChannels];
#pragma unroll
  for (int k = 0; k < kChannels; ++k) {
    const bool active = first + k < c.active_channels;
    live[k] = active ? parameters(first + k, i) : 0.0F;
    average[k] = active ? averages(first + k, i) : 0.0F;
  }
#pragma unroll
  for (int k = 0; k < kChannels; ++k) {
    if (first + k >= c.active_channels) continue;
    averages(first + k, i) = average[k] + share * (live[k] - average[k]);
  }
}

__global__ void find_dead_kernel(Columns c, FindDeadOptions options, std::uint8_t* dead, DeadCounts* counts) {
  const int i = static_cast<int>(blockIdx.x) * kThreads + static_cast<int>(threadIdx.x);
  bool finite = true, gone = false;
  if (i < c.count) {
    const ChannelsOfOne<float> parameters = Channels<float>{c.parameters, c.stride}.of(i);
    for (int channel = 0; channel < c.active_channels; ++channel) {
      finite = finite && isfinite(parameters[channel]);
    }
    const std::uint64_t born = c.birth[i], age = options.step > born ? options.step - born : 0;
    constexpr int kScale = ParameterLayout::kLogScale;
    const float largest = fmaxf(parameters[kScale], fmaxf(parameters[kScale + 1], parameters[kScale + 2]));
    const bool useless =
        parameters[ParameterLayout::kOpacityLogit] < options.min_opacity_logit || largest > options.max_log_scale;
    gone = !finite || (age >= options.min_age_steps && useless);
    dead[i] = gone ? 1 : 0;
  }
  const int removed = __syncthreads_count(gone), not_finite = __syncthreads_count(!finite);
  if (threadIdx.x != 0) return;
  if (removed > 0) atomicAdd(&counts->removed, static_cast<std::uint32_t>(removed));
  if (not_finite > 0) atomicAdd(&counts->not_finite, static_cast<std::uint32_t>(not_finite));
}

__global__ void set_birth_kernel(std::uint64_t* birth, int begin, int end, std::uint64_t step) {
  const int i = begin + static_cast<int>(blockIdx.x) * kThreads + static_cast<int>(threadIdx.x);
  if (i < end) birth[i] = step;
}

__global__ void move_birth_kernel(std::uint64_t* birth, const std::uint32_t* from, const std::uint32_t* to, int count) {
  const int k = static_cast<int>(blockIdx.x) * kThreads + static_cast<int>(threadIdx.x);
  if (k < count) birth[to[k]] = birth[from[k]];
}

}  // namespace

void launch_average(const Columns& columns, const AverageOptions& options, cudaStream_t stream) {
  if (options.begin >= options.end) return;
  const dim3 blocks(blocks_for(options.end - options.begin),
                    static_cast<unsigned>((columns.active_channels + kChannels - 1) / kChannels));
  average_kernel<<<blocks, kThreads, 0, stream>>>(columns, options);
  check(cudaGetLastError(), "averaging");
}

void launch_find_dead(const Columns& columns, const FindDeadOptions& options, std::uint8_t* dead, DeadCounts* counts,
                      cudaStream_t stream) {
  if (columns.count == 0) return;
  find_dead_kernel<<<blocks_for(columns.count), kThreads, 0, stream>>>(columns, options, dead, counts);
  check(cudaGetLastError(), "looking for Gaussians to remove");
}

void launch_set_birth(std::uint64_t* birth, int begin, int end, std::uint64_t step, cudaStream_t stream) {
  if (begin >= end) return;
  set_birth_kernel<<<blocks_for(end - begin), kThreads, 0, stream>>>(birth, begin, end, step);
  check(cudaGetLastError(), "setting ages");
}

void launch_move_birth(std::uint64_t* birth, const std::uint32_t* from, const std::uint32_t* to, int count,
                       cudaStream_t stream) {
  if (count == 0) return;
  move_birth_kernel<<<blocks_for(count), kThreads, 0, stream>>>(birth, from, to, count);
  check(cudaGetLastError(), "moving ages");
}

}  // namespace splatbus::trainer::cuda

#include "device/check.h"
#include "expander/cuda/device_math.cuh"

namespace splatbus::expander::cuda {
namespace {

using device::check;

/// One sample, read once: the sender may overwrite it at any time.
struct Sample {
  float3 position, normal, albedo, color;
  float spacing_m, cosine;
  std::uint32_t camera;
};

__device__ bool sound(const Sample& sample, std::uint32_t cameras, const SoundLimits& limits) {
  return finite(sample.position) && finite(sample.normal) && finite(sample.albedo) && finite(sample.color) &&
         isfinite(sample.cosine) && fabsf(sqrtf(dot(sample.normal, sample.normal)) - 1) < limits.unit_tolerance &&
         sample.spacing_m > 0 && sample.spacing_m < limits.largest_spacing_m && sample.camera < cameras;
}

__global__ void take_kernel(IncomingSamples incoming, RoundView round, SoundLimits limits, std::uint32_t* dropped) {
  const std::uint32_t i = thread_index();
  bool garbage = false;
  if (i < round.count) {
    const Sample sample{incoming.position[i],  incoming.normal[i], incoming.albedo[i], incoming.color[i],
                        incoming.spacing_m[i], incoming.cosine[i], incoming.camera[i]};
    garbage = !sound(sample, round.camera_count, limits);
    const auto clamped = [](float v) { return fminf(fmaxf(v, 0.0F), 1.0F); };
    const Samples& out = round.samples;
    out.position[i] = sample.position;
    out.normal[i] = sample.normal * (1.0F / sqrtf(dot(sample.normal, sample.normal)));
    out.albedo[i] = {clamped(sample.albedo.x), clamped(sample.albedo.y), clamped(sample.albedo.z)};
    out.color[i] = {fmaxf(sample.color.x, 0.0F), fmaxf(sample.color.y, 0.0F), fmaxf(sample.color.z, 0.0F)};
    out.spacing_m[i] = sample.spacing_m;
    out.cosine[i] = sample.cosine;
    out.object_id[i] = incoming.object_id[i];
    out.camera[i] = garbage ? kUnsound : sample.camera;
  }
  const int in_block = __syncthreads_count(garbage);
  if (threadIdx.x == 0 && in_block > 0) atomicAdd(dropped, static_cast<std::uint32_t>(in_block));
}

}  // namespace

void launch_take(const IncomingSamples& incoming, const RoundView& round, const SoundLimits& limits,
                 std::uint32_t* dropped, cudaStream_t stream) {
  check(cudaMemsetAsync(dropped, 0, sizeof(std::uint32_t), stream), "clearing a count");
  if (round.count == 0) return;
  take_kernel<<<blocks_for(round.count), kThreads, 0, stream>>>(incoming, round, limits, dropped);
  check(cudaGetLastError(), "taking samples");
}

}  // namespace splatbus::expander::cuda

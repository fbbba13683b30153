#include "device/check.h"
#include "raster/torch/cuda/adam_planes.h"

namespace splatbus::raster::cuda {
namespace {

constexpr int kThreads = 128;

__global__ void adam_planes_kernel(AdamPlanes a) {
  const std::int64_t i = static_cast<std::int64_t>(blockIdx.x) * kThreads + threadIdx.x;
  if (i >= a.count || a.touched[i] == 0) return;
  const std::uint32_t taken = a.steps[i] + 1;
  a.steps[i] = taken;
  const auto step = static_cast<float>(taken);
  const float rate =
      a.lr_half_life_steps > 0.0F ? fmaxf(a.lr_min_factor, a.lr_half_life_steps / (a.lr_half_life_steps + step)) : 1.0F;
  const float correction1 = rate / -expm1f(step * logf(a.beta1)), correction2 = 1.0F / -expm1f(step * logf(a.beta2));
#pragma unroll 4
  for (int c = 0; c < a.channels; ++c) {
    const std::int64_t at = c * a.count + i;
    const float g = a.gradient[at];
    const float m = a.beta1 * a.first[at] + (1.0F - a.beta1) * g;
    const float v = a.beta2 * a.second[at] + (1.0F - a.beta2) * g * g;
    a.first[at] = m;
    a.second[at] = v;
    a.parameters[at] -= a.rates[c] * m * correction1 / (sqrtf(v * correction2) + a.epsilon);
  }
}

}  // namespace

void launch_adam_planes(const AdamPlanes& adam, cudaStream_t stream) {
  if (adam.count == 0) return;
  const auto blocks = static_cast<unsigned>((adam.count + kThreads - 1) / kThreads);
  adam_planes_kernel<<<blocks, kThreads, 0, stream>>>(adam);
  device::check(cudaGetLastError(), "Adam on planes");
}

}  // namespace splatbus::raster::cuda

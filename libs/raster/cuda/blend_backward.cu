#include "raster/cuda/blend.cuh"

namespace splatbus::raster::cuda {
namespace {

constexpr float kLn2 = 0.6931471805599453F;

/// Sums eight values over a warp in nine shuffles: lane l ends with the sum of values[l >> 2].
__device__ inline float reduce8(float (&values)[8]) {
  const int lane = threadIdx.x & 31;
#pragma unroll
  for (int half = 4, mask = 16; half >= 1; half /= 2, mask /= 2) {
    const bool upper = (lane & mask) != 0;
#pragma unroll
    for (int k = 0; k < half; ++k) {
      const float send = upper ? values[k] : values[k + half];
      const float keep = upper ? values[k + half] : values[k];
      values[k] = keep + __shfl_xor_sync(0xFFFFFFFFU, send, mask);
    }
  }
  values[0] += __shfl_xor_sync(0xFFFFFFFFU, values[0], 2);
  return values[0] + __shfl_xor_sync(0xFFFFFFFFU, values[0], 1);
}

/// The same for four values, in six shuffles: lane l ends with the sum of values[l >> 3].
__device__ inline float reduce4(float (&values)[4]) {
  const int lane = threadIdx.x & 31;
#pragma unroll
  for (int half = 2, mask = 16; half >= 1; half /= 2, mask /= 2) {
    const bool upper = (lane & mask) != 0;
#pragma unroll
    for (int k = 0; k < half; ++k) {
      const float send = upper ? values[k] : values[k + half];
      const float keep = upper ? values[k + half] : values[k];
      values[k] = keep + __shfl_xor_sync(0xFFFFFFFFU, send, mask);
    }
  }
  float sum = values[0];
  for (int mask = 4; mask >= 1; mask /= 2) sum += __shfl_xor_sync(0xFFFFFFFFU, sum, mask);
  return sum;
}

__device__ inline float reduce1(float value) {
  for (int mask = 16; mask >= 1; mask /= 2) value += __shfl_xor_sync(0xFFFFFFFFU, value, mask);
  return value;
}

/// Front to back, as the forward pass and with its tests, so that both visit the same Gaussians. With G the part of
/// dL/dC . C that is blended so far and `total` all of it, dL/dalpha = T (c . g) - (total - G) / (1 - alpha).
template <bool kAlbedo>
__global__ void __launch_bounds__(kBlendThreads) blend_backward_kernel(DeviceGaussians gaussians, WorkspaceView w) {
  __shared__ Stage<kAlbedo> stage;
  const Pixel pixel = locate(w);
  const float px = pixel.x + 0.5F, py = pixel.y + 0.5F;
  const std::uint32_t warp_bit = 1U << (threadIdx.x >> 5);
  const int lane = threadIdx.x & 31;
  const uint2 range = w.tile_range[pixel.tile];
  float g[3] = {0.0F, 0.0F, 0.0F}, g_albedo[3] = {0.0F, 0.0F, 0.0F}, total = 0.0F;
  if (pixel.inside) {
    const std::size_t pixels = static_cast<std::size_t>(w.width) * w.height;
    const std::size_t at = 3 * pixels * pixel.view + static_cast<std::size_t>(pixel.y) * w.width + pixel.x;
    for (int c = 0; c < 3; ++c) {
      g[c] = w.color_gradient[at + c * pixels];
      total += g[c] * w.color[at + c * pixels];
      if constexpr (kAlbedo) {
        g_albedo[c] = w.albedo_gradient[at + c * pixels];
        total += g_albedo[c] * w.albedo[at + c * pixels];
      }
    }
  }
  float transmittance = 1.0F, rest = total;
  bool done = !pixel.inside;
  for (std::uint32_t first = range.x; first < range.y; first += kBlendThreads) {
    if (__syncthreads_and(done)) break;
    load_stage(stage, gaussians, w, pixel.view, first + threadIdx.x, range.y, pixel.x0, pixel.y0);
    __syncthreads();
    for (int chunk = 0; chunk < kBlendThreads; chunk += 32) {
      if (__all_sync(0xFFFFFFFFU, done)) break;
      std::uint32_t hits = __ballot_sync(0xFFFFFFFFU, (stage.patches[chunk + lane] & warp_bit) != 0);
      while (hits != 0) {
        const int j = chunk + __ffs(hits) - 1;
        hits &= hits - 1;
        const float4 geometry = stage.geometry[j];
        const float4 shading = stage.shading[j];
        const float dx = px - geometry.x, dy = py - geometry.y;
        const float power = (geometry.z * dx + geometry.w * dy) * dx + shading.x * dy * dy;
        const float falloff = exp2_approximate(power);
        const float alpha = fminf(kAlphaMax, shading.y * falloff);
        bool counts = !done && alpha >= kAlphaMin && power <= 0.0F;
        const float next = transmittance * (1.0F - alpha);
        if (counts && next < kTransmittanceMin) {
          done = true;
          counts = false;
        }
        if (!__any_sync(0xFFFFFFFFU, counts)) continue;
        float sums[8] = {};
        float tail_sums[4] = {};
        if (counts) {
          const float weight = alpha * transmittance;
          const float2 tail = stage.tail[j];
          float along = g[0] * shading.z + g[1] * shading.w + g[2] * tail.x;
          if constexpr (kAlbedo) {
            const float4 a = stage.albedo[j];
            along += g_albedo[0] * a.x + g_albedo[1] * a.y + g_albedo[2] * a.z;
          }
          rest -= weight * along;
          const float d_alpha = transmittance * along - rest / (1.0F - alpha);
          transmittance = next;
          if (shading.y * falloff < kAlphaMax) {
            sums[5] = falloff * d_alpha;
            const float d_power = kLn2 * alpha * d_alpha;  // alpha = o 2^power
            sums[0] = -d_power * (2.0F * geometry.z * dx + geometry.w * dy);
            sums[1] = -d_power * (geometry.w * dx + 2.0F * shading.x * dy);
            sums[2] = d_power * dx * dx;
            sums[3] = d_power * dx * dy;
            sums[4] = d_power * dy * dy;
          }
          sums[6] = weight * g[0];
          sums[7] = weight * g[1];
          tail_sums[0] = weight * g[2];
          if constexpr (kAlbedo) {
            for (int c = 0; c < 3; ++c) tail_sums[1 + c] = weight * g_albedo[c];
          }
        }
        float* out = w.record_gradient + static_cast<std::size_t>(stage.record[j]) * kGradientFloats;
        const float sum = reduce8(sums);
        if ((lane & 3) == 0) atomicAdd(out + (lane >> 2), sum);
        if constexpr (kAlbedo) {
          const float tail_sum = reduce4(tail_sums);
          if ((lane & 7) == 0) atomicAdd(out + 8 + (lane >> 3), tail_sum);
        } else {
          const float tail_sum = reduce1(tail_sums[0]);
          if (lane == 0) atomicAdd(out + 8, tail_sum);
        }
      }
    }
  }
}

}  // namespace

void launch_blend_backward(const DeviceGaussians& gaussians, const WorkspaceView& workspace, cudaStream_t stream) {
  const std::size_t records = static_cast<std::size_t>(workspace.count) * workspace.batch;
  check(cudaMemsetAsync(workspace.record_gradient, 0, records * kGradientFloats * sizeof(float), stream),
        "clearing the record gradients");
  const int blocks = workspace.tiles_x * workspace.tiles_y * workspace.batch;
  if (blocks == 0) return;
  if (workspace.albedo != nullptr) {
    blend_backward_kernel<true><<<blocks, kBlendThreads, 0, stream>>>(gaussians, workspace);
  } else {
    blend_backward_kernel<false><<<blocks, kBlendThreads, 0, stream>>>(gaussians, workspace);
  }
  check(cudaGetLastError(), "backward blending");
}

}  // namespace splatbus::raster::cuda

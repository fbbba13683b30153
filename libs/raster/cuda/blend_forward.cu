#include "raster/cuda/blend.cuh"

namespace splatbus::raster::cuda {
namespace {

template <bool kAlbedo>
__global__ void __launch_bounds__(kBlendThreads) blend_forward_kernel(DeviceGaussians gaussians, WorkspaceView w) {
  __shared__ Stage<kAlbedo> stage;
  __shared__ float deepest;
  const Pixel pixel = locate(w);
  const float px = pixel.x + 0.5F, py = pixel.y + 0.5F;
  const std::uint32_t warp_bit = 1U << (threadIdx.x >> 5);
  const int lane = threadIdx.x & 31;
  const uint2 range = w.tile_range[pixel.tile];
  if (threadIdx.x == 0) deepest = 0.0F;
  float transmittance = 1.0F, red = 0.0F, green = 0.0F, blue = 0.0F, last_depth = 0.0F;
  float albedo[3] = {0.0F, 0.0F, 0.0F};
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
        if (done) continue;
        const float4 geometry = stage.geometry[j];
        const float4 shading = stage.shading[j];
        const float dx = px - geometry.x, dy = py - geometry.y;
        const float power = (geometry.z * dx + geometry.w * dy) * dx + shading.x * dy * dy;
        const float alpha = fminf(kAlphaMax, shading.y * exp2_approximate(power));
        if (alpha < kAlphaMin || power > 0.0F) continue;
        const float next = transmittance * (1.0F - alpha);
        if (next < kTransmittanceMin) {
          done = true;
          continue;
        }
        const float weight = alpha * transmittance;
        const float2 tail = stage.tail[j];
        red += weight * shading.z;
        green += weight * shading.w;
        blue += weight * tail.x;
        if constexpr (kAlbedo) {
          albedo[0] += weight * stage.albedo[j].x;
          albedo[1] += weight * stage.albedo[j].y;
          albedo[2] += weight * stage.albedo[j].z;
        }
        last_depth = tail.y;
        transmittance = next;
      }
    }
  }
  // A pixel that never became opaque makes the tile's limit infinite.
  const float limit = done ? last_depth : __int_as_float(0x7F800000);
  if (pixel.inside) {
    const std::size_t pixels = static_cast<std::size_t>(w.width) * w.height;
    const std::size_t at = static_cast<std::size_t>(pixel.y) * w.width + pixel.x;
    const float* background = w.views[pixel.view].background;
    float* color = w.color + 3 * pixels * pixel.view + at;
    color[0] = red + transmittance * background[0];
    color[pixels] = green + transmittance * background[1];
    color[2 * pixels] = blue + transmittance * background[2];
    w.transmittance[pixels * pixel.view + at] = transmittance;
    if constexpr (kAlbedo) {
      float* out = w.albedo + 3 * pixels * pixel.view + at;
      for (int c = 0; c < 3; ++c) out[c * pixels] = albedo[c];
    }
    // Positive floats compare as their bits do.
    atomicMax(reinterpret_cast<int*>(&deepest), __float_as_int(limit));
  }
  __syncthreads();
  if (threadIdx.x == 0) w.tile_depth_limit[pixel.tile] = deepest;
}

}  // namespace

void launch_blend_forward(const DeviceGaussians& gaussians, const WorkspaceView& workspace, cudaStream_t stream) {
  const int blocks = workspace.tiles_x * workspace.tiles_y * workspace.batch;
  if (blocks == 0) return;
  if (workspace.albedo != nullptr) {
    blend_forward_kernel<true><<<blocks, kBlendThreads, 0, stream>>>(gaussians, workspace);
  } else {
    blend_forward_kernel<false><<<blocks, kBlendThreads, 0, stream>>>(gaussians, workspace);
  }
  check(cudaGetLastError(), "forward blending");
}

}  // namespace splatbus::raster::cuda

#pragma once

#include "raster/cuda/footprint.cuh"
#include "raster/cuda/kernels.h"

namespace splatbus::raster::cuda {

constexpr int kBlendThreads = kTileSize * kTileSize;
constexpr int kPatchWidth = 8, kPatchHeight = 4;  // a warp's pixels; 2 x 4 patches a tile

/// Gaussians of a tile, staged in shared memory for all its warps.
template <bool kAlbedo>
struct Stage {
  float4 geometry[kBlendThreads];  // x, y, a, b
  float4 shading[kBlendThreads];   // c, opacity, red, green
  float2 tail[kBlendThreads];      // blue, depth
  float4 albedo[kAlbedo ? kBlendThreads : 1];
  std::uint32_t record[kBlendThreads];
  std::uint32_t patches[kBlendThreads];  // bit p: reaches 1/255 somewhere in patch p
};

/// Which patches of the tile at pixel (x0, y0) the ellipse {alpha >= 1/255} meets.
__device__ inline std::uint32_t patch_mask(const float4 geometry, float c, float opacity, int x0, int y0) {
  // q(dx, dy) = -(a dx^2 + b dx dy + c dy^2) <= level, all powers of two.
  const float a = -geometry.z, b = -geometry.w, cc = -c;
  const float level = __log2f(opacity * 255.0F);
  const float inv_det4 = 1.0F / fmaxf(4.0F * a * cc - b * b, 1e-30F);
  const float half_y = sqrtf(fmaxf(4.0F * a * level * inv_det4, 0.0F));
  const float half_x = sqrtf(fmaxf(4.0F * cc * level * inv_det4, 0.0F));
  const float extreme = -b * half_x / (2.0F * cc);  // dy at the rightmost point
  const float inv_2a = 0.5F / a;
  std::uint32_t mask = 0;
#pragma unroll
  for (int row = 0; row < kTileSize / kPatchHeight; ++row) {
    // Pixel centres of the band.
    const float top = y0 + row * kPatchHeight + 0.5F - geometry.y, bottom = top + (kPatchHeight - 1);
    const float low = fmaxf(top, -half_y), high = fminf(bottom, half_y);
    if (low > high) continue;
    const float dy_right = fminf(fmaxf(extreme, low), high), dy_left = fminf(fmaxf(-extreme, low), high);
    const float right =
        inv_2a * (-b * dy_right +
                  sqrtf(fmaxf(b * b * dy_right * dy_right - 4.0F * a * (cc * dy_right * dy_right - level), 0.0F)));
    const float left =
        inv_2a *
        (-b * dy_left - sqrtf(fmaxf(b * b * dy_left * dy_left - 4.0F * a * (cc * dy_left * dy_left - level), 0.0F)));
    const float x_first = x0 + 0.5F - geometry.x;
    if (right >= x_first && left <= x_first + (kPatchWidth - 1)) mask |= 1U << (2 * row);
    if (right >= x_first + kPatchWidth && left <= x_first + (2 * kPatchWidth - 1)) mask |= 2U << (2 * row);
  }
  return mask;
}

template <bool kAlbedo>
__device__ inline void load_stage(Stage<kAlbedo>& stage, const DeviceGaussians& gaussians, const WorkspaceView& w,
                                  int view, std::uint32_t pair, std::uint32_t end, int x0, int y0) {
  const int t = threadIdx.x;
  std::uint32_t mask = 0;
  if (pair < end) {
    const std::uint32_t record = w.pair_records[1][pair];
    const float4 shading = w.record_shading[record];
    if (shading.y >= kAlphaMin) {
      const float4 geometry = w.record_geometry[record];
      mask = patch_mask(geometry, shading.x, shading.y, x0, y0);
      stage.geometry[t] = geometry;
      stage.shading[t] = shading;
      stage.tail[t] = w.record_tail[record];
      stage.record[t] = record;
      if constexpr (kAlbedo) {
        const int i = static_cast<int>(record - static_cast<std::uint32_t>(view) * w.count);
        const float* p = gaussians.parameters + ParameterLayout::kAlbedo * gaussians.stride + i;
        stage.albedo[t] = make_float4(p[0], p[gaussians.stride], p[2 * gaussians.stride], 0.0F);
      }
    }
  }
  stage.patches[t] = mask;
}

__device__ inline float exp2_approximate(float x) {
  float y;
  asm("ex2.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x));
  return y;
}

/// Where this thread's pixel lies.
struct Pixel {
  int tile, view, x, y, x0, y0;
  bool inside;
};

__device__ inline Pixel locate(const WorkspaceView& w) {
  Pixel p;
  const int tiles = w.tiles_x * w.tiles_y;
  p.tile = blockIdx.x;
  p.view = p.tile / tiles;
  const int in_view = p.tile - p.view * tiles;
  p.y0 = (in_view / w.tiles_x) * kTileSize;
  p.x0 = (in_view % w.tiles_x) * kTileSize;
  const int warp = threadIdx.x >> 5, lane = threadIdx.x & 31;
  p.x = p.x0 + (warp & 1) * kPatchWidth + (lane & 7);
  p.y = p.y0 + (warp >> 1) * kPatchHeight + (lane >> 3);
  p.inside = p.x < w.width && p.y < w.height;
  return p;
}

}  // namespace splatbus::raster::cuda

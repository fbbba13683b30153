#include "raster/cuda/footprint.cuh"
#include "raster/cuda/kernels.h"
#include "raster/cuda/projection_math.cuh"

namespace splatbus::raster::cuda {
namespace {

constexpr int kThreads = 128;
constexpr float kLog2E = 1.4426950408889634F;

struct Shading {
  const float* parameters;
  std::int64_t stride;
  const float* normal;
  const float* visibility;
  int coefficients;
};

__device__ float3 radiance_color(const Shading& s, int i, const float3 mean, const ObjectView& object) {
  float3 d = make_float3(mean.x - object.camera_in_object[0], mean.y - object.camera_in_object[1],
                         mean.z - object.camera_in_object[2]);
  const float inv = rsqrtf(fmaxf(d.x * d.x + d.y * d.y + d.z * d.z, 1e-20F));
  d = make_float3(d.x * inv, d.y * inv, d.z * inv);
  float y[16];
  sh_basis(d, s.coefficients, y);
  float3 color = make_float3(0.5F, 0.5F, 0.5F);
  const float* p = s.parameters + ParameterLayout::kAppearance * s.stride + i;
#pragma unroll
  for (int k = 0; k < 16; ++k) {
    if (k < s.coefficients) {
      color.x += y[k] * p[(3 * k) * s.stride];
      color.y += y[k] * p[(3 * k + 1) * s.stride];
      color.z += y[k] * p[(3 * k + 2) * s.stride];
    }
  }
  return color;
}

__device__ float3 transfer_color(const Shading& s, int i, const ObjectView& object) {
  const float3 n = make_float3(s.normal[i], s.normal[s.stride + i], s.normal[2 * s.stride + i]);
  const float visibility = s.visibility[i];
  const float* p = s.parameters + ParameterLayout::kAlbedo * s.stride + i;
  const float3 response = diffuse_response(object, n, visibility);
  float3 color = make_float3(p[0] * response.x, p[s.stride] * response.y, p[2 * s.stride] * response.z);
  float sun[9];
  sh_basis(make_float3(object.sun_direction[0], object.sun_direction[1], object.sun_direction[2]), 9, sun);
  const float* r = s.parameters + ParameterLayout::kResidual * s.stride + i;
#pragma unroll
  for (int k = 0; k < 9; ++k) {
    const float3 light = residual_light(object, k, sun[k], visibility);
    color.x += r[(3 * k) * s.stride] * light.x;
    color.y += r[(3 * k + 1) * s.stride] * light.y;
    color.z += r[(3 * k + 2) * s.stride] * light.z;
  }
  return color;
}

template <bool kTransfer>
__global__ void __launch_bounds__(kThreads)
    project_kernel(DeviceGaussians gaussians, WorkspaceView w, ProjectOptions options) {
  const int i = blockIdx.x * kThreads + threadIdx.x;
  const bool present = i < w.count;
  const int lane = threadIdx.x & 31;
  GaussianGeometry g;
  float opacity = 0.0F;
  Shading shading{gaussians.parameters, gaussians.stride, gaussians.normal, gaussians.visibility,
                  gaussians.layout.sh_coefficients()};
  int slot = 0;
  if (present) {
    g = load_geometry(gaussians.parameters, gaussians.stride, i);
    opacity = sigmoid(g.opacity_logit);
    if (w.object_slot != nullptr) slot = w.object_slot[i];
  }
  for (int b = 0; b < w.batch; ++b) {
    const DeviceView& view = w.views[b];
    Projection p;
    Footprint footprint;
    bool visible = false;
    const std::uint32_t record = static_cast<std::uint32_t>(b) * w.count + i;
    if (present) {
      const ObjectView& object = w.object_views[b * w.object_count + slot];
      visible = project(g, object, view, options.blur_px2, options.antialias, p);
      const float alpha_peak = opacity * p.compensation;
      visible = visible && alpha_peak >= kAlphaMin;
      if (visible) {
        const float x = view.fx * p.view.x / p.view.z + view.cx, y = view.fy * p.view.y / p.view.z + view.cy;
        visible = footprint.set(x, y, p.a, p.b, p.c, p.det, alpha_peak, options.pair_margin_px, w);
        if (visible) {
          float3 color = kTransfer ? transfer_color(shading, i, object) : radiance_color(shading, i, g.mean, object);
          visible = isfinite(color.x + color.y + color.z);
          const float inv_det = 1.0F / p.det;
          w.record_geometry[record] = make_float4(x, y, -0.5F * kLog2E * p.c * inv_det, kLog2E * p.b * inv_det);
          w.record_shading[record] = make_float4(-0.5F * kLog2E * p.a * inv_det, visible ? alpha_peak : 0.0F,
                                                 fmaxf(color.x, 0.0F), fmaxf(color.y, 0.0F));
          w.record_tail[record] = make_float2(fmaxf(color.z, 0.0F), p.view.z);
        }
      }
      if (!visible) w.record_shading[record] = make_float4(0.0F, 0.0F, 0.0F, 0.0F);
    }
    if (!options.emit_pairs) continue;
    const float* limits =
        options.use_depth_limit ? w.tile_depth_limit + static_cast<std::size_t>(b) * w.tiles_x * w.tiles_y : nullptr;
    std::uint32_t count = 0;
    if (visible) count = footprint.for_each_tile(w, limits, p.view.z, [](int) {});
    // One atomic a warp: an inclusive scan gives each lane its place.
    std::uint32_t end = count;
    for (int step = 1; step < 32; step *= 2) {
      const std::uint32_t other = __shfl_up_sync(0xFFFFFFFFU, end, step);
      if (lane >= step) end += other;
    }
    std::uint32_t base = 0;
    if (lane == 31 && end > 0) base = atomicAdd(w.pair_count, end);
    base = __shfl_sync(0xFFFFFFFFU, base, 31) + end - count;
    if (count == 0) continue;
    const std::uint64_t depth_bits = __float_as_uint(p.view.z);
    const std::uint64_t first_tile = static_cast<std::uint64_t>(b) * w.tiles_x * w.tiles_y;
    footprint.for_each_tile(w, limits, p.view.z, [&](int tile) {
      if (base < w.pair_capacity) {
        w.pair_keys[0][base] = ((first_tile + tile) << 32U) | depth_bits;
        w.pair_records[0][base] = record;
      }
      ++base;
    });
  }
}

}  // namespace

void launch_project(const DeviceGaussians& gaussians, const WorkspaceView& workspace, const ProjectOptions& options,
                    cudaStream_t stream) {
  if (options.emit_pairs) {
    check(cudaMemsetAsync(workspace.pair_count, 0, sizeof(std::uint32_t), stream), "clearing the pair count");
    check(cudaMemsetAsync(workspace.pair_keys[0], 0xFF, sizeof(std::uint64_t) * workspace.pair_capacity, stream),
          "clearing the pairs");
  }
  const int blocks = (workspace.count + kThreads - 1) / kThreads;
  if (blocks == 0) return;
  if (gaussians.layout.appearance == Appearance::Transfer) {
    project_kernel<true><<<blocks, kThreads, 0, stream>>>(gaussians, workspace, options);
  } else {
    project_kernel<false><<<blocks, kThreads, 0, stream>>>(gaussians, workspace, options);
  }
  check(cudaGetLastError(), "projection");
}

}  // namespace splatbus::raster::cuda

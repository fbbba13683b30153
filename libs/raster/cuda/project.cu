#include "raster/cuda/footprint.cuh"
#include "raster/cuda/kernels.h"
#include "raster/cuda/projection_math.cuh"

namespace splatbus::raster::cuda {
namespace {

constexpr int kThreads = 128;

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
  const float3 n = load_normal(s.normal, s.stride, i);
  const float visibility = s.visibility != nullptr ? s.visibility[i] : 1.0F;
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

/// -0 marks a channel that was clamped, so that the backward pass knows.
__device__ float clamp_color(float raw) {
  return raw < 0.0F ? -0.0F : raw + 0.0F;
}

__device__ bool bounded(float value) {
  return fabsf(value) < 1e15F;
}

/// Projects and shades Gaussian i in one view; false when it cannot be seen.
template <bool kTransfer>
__device__ bool write_record(const GaussianGeometry& g, float opacity, const Shading& shading, int i,
                             const ObjectView& object, const DeviceView& view, const ProjectOptions& options,
                             const WorkspaceView& w, std::size_t record, Footprint& footprint, float& depth) {
  Projection p;
  if (!project(g, object, view, options.blur_px2, p)) return false;
  const float alpha = options.antialias ? opacity * sqrtf(p.det_sharp / p.det) : opacity;
  if (!(alpha >= kAlphaMin)) return false;
  const float x = view.fx * p.view.x / p.view.z + view.cx, y = view.fy * p.view.y / p.view.z + view.cy;
  const float log2_alpha = log2f(alpha);
  const Whitening u = whitening(p);
  if (!footprint.set(x, y, p, u, log2_alpha, options.pair_margin_px, w)) return false;
  const float3 color = kTransfer ? transfer_color(shading, i, object) : radiance_color(shading, i, g.mean, object);
  if (!(bounded(color.x) && bounded(color.y) && bounded(color.z))) return false;
  if constexpr (kTransfer) {
    const float* albedo = shading.parameters + ParameterLayout::kAlbedo * shading.stride + i;
    if (!(bounded(albedo[0]) && bounded(albedo[shading.stride]) && bounded(albedo[2 * shading.stride]))) return false;
  }
  depth = p.view.z;
  w.record_shape[2 * record] = make_float4(x, y, log2_alpha, u.uxx);
  w.record_shape[2 * record + 1] = make_float4(u.uxy, u.uyy, clamp_color(color.x), clamp_color(color.y));
  w.record_tail[record] = make_float2(clamp_color(color.z), depth);
  return true;
}

template <bool kTransfer>
__global__ void __launch_bounds__(kThreads, 6)
    project_kernel(DeviceGaussians gaussians, WorkspaceView w, ProjectOptions options) {
  const int i = blockIdx.x * kThreads + threadIdx.x;
  const bool present = i < w.count;
  const int lane = threadIdx.x & 31;
  GaussianGeometry g;
  float opacity = 0.0F;
  const Shading shading{gaussians.parameters, gaussians.stride, gaussians.normal, gaussians.visibility,
                        gaussians.layout.sh_coefficients()};
  int slot = 0;
  if (present) {
    g = load_geometry(gaussians.parameters, gaussians.stride, i);
    opacity = sigmoid(g.opacity_logit);
    if (w.object_slot != nullptr) slot = w.object_slot[i];
  }
  const int tiles = w.tiles_x * w.tiles_y;
  for (int b = 0; b < w.batch; ++b) {
    Footprint footprint;
    float depth = 0.0F;
    bool visible = false;
    if (present) {
      const std::size_t record = static_cast<std::size_t>(b) * w.count + i;
      visible = write_record<kTransfer>(g, opacity, shading, i, w.object_views[b * w.object_count + slot], w.views[b],
                                        options, w, record, footprint, depth);
      // A list of an earlier step may still name it.
      if (!visible) w.record_shape[2 * record] = make_float4(0.0F, 0.0F, -INFINITY, 0.0F);
    }
    if (!options.emit_pairs) continue;
    const float* limits = options.use_depth_limit ? w.patch_depth_limit + b * tiles * kPatches : nullptr;
    std::uint32_t count = 0;
    if (visible) count = footprint.for_each_tile(w, limits, depth, [](int, std::uint32_t) {});
    // One atomic a warp: an inclusive scan gives each lane its place.
    std::uint32_t end = count;
    for (int step = 1; step < 32; step *= 2) {
      const std::uint32_t other = __shfl_up_sync(0xFFFFFFFFU, end, step);
      if (lane >= step) end += other;
    }
    std::uint32_t at = 0;
    if (lane == 31 && end > 0) at = atomicAdd(w.pair_count, end);
    at = __shfl_sync(0xFFFFFFFFU, at, 31) + end - count;
    if (count == 0) continue;
    footprint.for_each_tile(w, limits, depth, [&](int tile, std::uint32_t patches) {
      if (at < w.pair_capacity) {
        w.pair_keys[0][at] = (static_cast<std::uint64_t>(b * tiles + tile) << 32U) | __float_as_uint(depth);
        w.pair_entries[0][at] = static_cast<std::uint32_t>(i) | patches << kPatchShift;
      }
      ++at;
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

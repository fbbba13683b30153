#include "raster/cuda/appearance_dispatch.h"
#include "raster/cuda/footprint.cuh"
#include "raster/cuda/kernels.h"
#include "raster/cuda/projection_math.cuh"
#include "raster/cuda/sort_key.h"

namespace splatbus::raster::cuda {
namespace {

constexpr int kThreads = 128;

struct Shading {
  const float* parameters;
  std::int64_t stride;
  const float* normal;
  const float* visibility;
};

template <int kCoefficients>
__device__ float3 radiance_color(const Shading& s, int i, const float3 mean, const ObjectView& object) {
  float3 d = make_float3(mean.x - object.camera_in_object[0], mean.y - object.camera_in_object[1],
                         mean.z - object.camera_in_object[2]);
  const float inv = rsqrtf(fmaxf(d.x * d.x + d.y * d.y + d.z * d.z, 1e-20F));
  d = make_float3(d.x * inv, d.y * inv, d.z * inv);
  float y[kCoefficients];
  sh_basis<kCoefficients>(d, y);
  float color[3] = {0.5F, 0.5F, 0.5F};
  const float* p = recomputed(s.parameters + ParameterLayout::kAppearance * s.stride + i);
#pragma unroll
  for (int k = 0; k < kCoefficients; ++k) {
#pragma unroll
    for (int c = 0; c < 3; ++c) color[c] += y[k] * p[(3 * k + c) * s.stride];
  }
  return make_float3(color[0], color[1], color[2]);
}

__device__ float3 transfer_color(const Shading& s, int i, const ObjectView& object) {
  const float3 n = load_normal(s.normal, s.stride, i);
  const float visibility = s.visibility != nullptr ? s.visibility[i] : 1.0F;
  const float* p = s.parameters + ParameterLayout::kAlbedo * s.stride + i;
  const float3 response = diffuse_response(object, n, visibility);
  float3 color = make_float3(p[0] * response.x, p[s.stride] * response.y, p[2 * s.stride] * response.z);
  float sun[9];
  sh_basis<9>(make_float3(object.sun_direction[0], object.sun_direction[1], object.sun_direction[2]), sun);
  const float* r = recomputed(s.parameters + ParameterLayout::kResidual * s.stride + i);
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

/// What projection knows of a Gaussian in one view.
struct Seen {
  Projection p;
  Whitening white;
  float x, y, log2_alpha;

  /// False when it cannot be seen.
  __device__ bool set(const GaussianGeometry& g, float opacity, const ObjectView& object, const DeviceView& view,
                      const ProjectOptions& options) {
    if (!project(g, object, view, options.blur_px2, p)) return false;
    const float alpha = options.antialias ? opacity * sqrtf(p.det_sharp / p.det) : opacity;
    if (!(alpha >= kAlphaMin)) return false;
    log2_alpha = log2f(alpha);
    white = whitening(p);
    x = view.fx * p.view.x / p.view.z + view.cx;
    y = view.fy * p.view.y / p.view.z + view.cy;
    return true;
  }
};

/// False when the colour is not finite.
template <int kCoefficients>
__device__ bool shade(const Shading& s, int i, const float3 mean, const ObjectView& object, float3& color) {
  if constexpr (kCoefficients > 0) {
    color = radiance_color<kCoefficients>(s, i, mean, object);
  } else {
    color = transfer_color(s, i, object);
    const float* albedo = s.parameters + ParameterLayout::kAlbedo * s.stride + i;
    if (!(bounded(albedo[0]) && bounded(albedo[s.stride]) && bounded(albedo[2 * s.stride]))) return false;
  }
  return bounded(color.x) && bounded(color.y) && bounded(color.z);
}

/// Appends the pairs of a warp's Gaussians in one view; true for those that have any.
__device__ bool emit(const Footprint& footprint, bool visible, int i, int b, float depth, const ProjectOptions& options,
                     const WorkspaceView& w) {
  const int tiles = w.tiles_x * w.tiles_y, lane = threadIdx.x & 31;
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
  if (count == 0) return false;
  const SortKey key(w);
  footprint.for_each_tile(w, limits, depth, [&](int tile, std::uint32_t patches) {
    if (at < w.pair_capacity) {
      w.pair_keys[0][at] = key.of(b * tiles + tile, depth, w.views[b].near_m);
      w.pair_entries[0][at] = static_cast<std::uint32_t>(i) | patches << kPatchShift;
    }
    ++at;
  });
  return true;
}

/// With kEmit, lists are built and w.listed says for each Gaussian in which views it is in a list; without, only what
/// is in a list is projected. Shading comes last, for what was listed, when little else is held in registers.
template <int kCoefficients, bool kEmit>
__global__ void __launch_bounds__(kThreads, 6)
    project_kernel(DeviceGaussians gaussians, WorkspaceView w, ProjectOptions options) {
  const int i = blockIdx.x * kThreads + threadIdx.x;
  const bool present = i < w.count;
  const std::uint32_t candidates = kEmit ? (1U << w.batch) - 1 : (present ? w.listed[i] : 0U);
  if (!kEmit && candidates == 0) return;
  GaussianGeometry g;
  float opacity = 0.0F;
  const Shading shading{gaussians.parameters, gaussians.stride, gaussians.normal, gaussians.visibility};
  int slot = 0;
  if (present) {
    g = load_geometry(gaussians.parameters, gaussians.stride, i);
    opacity = sigmoid(g.opacity_logit);
    if (w.object_slot != nullptr) slot = w.object_slot[i];
  }
  std::uint32_t listed = 0;
  for (int b = 0; b < w.batch; ++b) {
    if (!kEmit && (candidates >> b & 1U) == 0) continue;
    const std::size_t record = static_cast<std::size_t>(b) * w.count + i;
    const ObjectView& object = w.object_views[b * w.object_count + slot];
    float depth = 0.0F;
    bool visible = false;
    {
      Seen seen;
      visible = present && seen.set(g, opacity, object, w.views[b], options);
      if (visible) depth = seen.p.view.z;
      if constexpr (kEmit) {
        Footprint footprint;
        visible =
            visible && footprint.set(seen.x, seen.y, seen.p, seen.white, seen.log2_alpha, options.pair_margin_px, w);
        visible = emit(footprint, visible, i, b, depth, options, w);
      }
      if (visible) {
        listed |= 1U << b;
        w.record_shape[2 * record] = make_float4(seen.x, seen.y, seen.log2_alpha, seen.white.uxx);
        *reinterpret_cast<float2*>(w.record_shape + 2 * record + 1) = make_float2(seen.white.uxy, seen.white.uyy);
      }
    }
    float3 color;
    if (visible && shade<kCoefficients>(shading, i, g.mean, object, color)) {
      reinterpret_cast<float2*>(w.record_shape + 2 * record + 1)[1] =
          make_float2(clamp_color(color.x), clamp_color(color.y));
      w.record_tail[record] = make_float2(clamp_color(color.z), depth);
    } else if (present && (visible || !kEmit)) {
      // It is in a list, but not to be seen: what is blended with a weight of 0 must be finite, too.
      w.record_shape[2 * record] = make_float4(0.0F, 0.0F, -INFINITY, 0.0F);
      w.record_shape[2 * record + 1] = make_float4(0.0F, 0.0F, 0.0F, 0.0F);
      w.record_tail[record] = make_float2(0.0F, 0.0F);
    }
  }
  if (kEmit && present) w.listed[i] = static_cast<std::uint16_t>(listed);
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
  with_coefficients(gaussians.layout, [&](auto coefficients) {
    if (options.emit_pairs) {
      project_kernel<coefficients(), true><<<blocks, kThreads, 0, stream>>>(gaussians, workspace, options);
    } else {
      project_kernel<coefficients(), false><<<blocks, kThreads, 0, stream>>>(gaussians, workspace, options);
    }
  });
  check(cudaGetLastError(), "projection");
}

}  // namespace splatbus::raster::cuda

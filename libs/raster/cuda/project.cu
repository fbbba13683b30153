#include "raster/cuda/appearance_dispatch.h"
#include "raster/cuda/footprint.cuh"
#include "raster/cuda/kernels.h"
#include "raster/cuda/projection_math.cuh"
#include "raster/cuda/range_lanes.cuh"
#include "raster/cuda/sort_key.h"
#include "raster/cuda/source_light.cuh"

namespace splatbus::raster::cuda {
namespace {

constexpr int kThreads = 128;

template <int kCoefficients>
__device__ float3 radiance_color(const DeviceGaussians& gaussians, int i, const float3 mean, const ObjectView& object) {
  float3 d = make_float3(mean.x - object.camera_in_object[0], mean.y - object.camera_in_object[1],
                         mean.z - object.camera_in_object[2]);
  const float inv = rsqrtf(fmaxf(d.x * d.x + d.y * d.y + d.z * d.z, 1e-20F));
  d = make_float3(d.x * inv, d.y * inv, d.z * inv);
  float y[kCoefficients];
  sh_basis<kCoefficients>(d, y);
  float color[3] = {0.5F, 0.5F, 0.5F};
  const ChannelsOfOne<float> p = parameters_of(gaussians).of(i, ParameterLayout::kAppearance).recomputed();
#pragma unroll
  for (int k = 0; k < kCoefficients; ++k) {
#pragma unroll
    for (int c = 0; c < 3; ++c) color[c] += y[k] * p[3 * k + c];
  }
  return make_float3(color[0], color[1], color[2]);
}

template <bool kSources>
__device__ float3 transfer_color(const DeviceGaussians& gaussians, int i, const float3 mean, const ObjectView& object,
                                 const WorkspaceView& w, int b) {
  const float3 n = load_normal(normals_of(gaussians), i);
  const float visibility = visibility_of(gaussians, w.views[b], i);
  const ChannelsOfOne<float> p = parameters_of(gaussians).of(i, ParameterLayout::kAlbedo);
  float3 response = diffuse_response(object, n, visibility);
  // Light is summed over the sources before it meets the residual, whose channels are read once.
  float from_sources[27] = {};
  if constexpr (kSources) {
    for_each_source(w, b, object, mean, i, [&](const float3 irradiance, const float3 to_light) {
      const float cosine = facing(n, to_light);
      response = make_float3(response.x + cosine * irradiance.x, response.y + cosine * irradiance.y,
                             response.z + cosine * irradiance.z);
      float y[9];
      sh_basis<9>(to_light, y);
#pragma unroll
      for (int k = 0; k < 9; ++k) {
        from_sources[3 * k] += y[k] * irradiance.x;
        from_sources[3 * k + 1] += y[k] * irradiance.y;
        from_sources[3 * k + 2] += y[k] * irradiance.z;
      }
    });
  }
  float3 color = make_float3(p[0] * response.x, p[1] * response.y, p[2] * response.z);
  float sun[9];
  sh_basis<9>(make_float3(object.sun_direction[0], object.sun_direction[1], object.sun_direction[2]), sun);
  const ChannelsOfOne<float> r = parameters_of(gaussians).of(i, ParameterLayout::kResidual).recomputed();
#pragma unroll
  for (int k = 0; k < 9; ++k) {
    float3 light = residual_light(object, k, sun[k], visibility);
    if constexpr (kSources) {
      light = make_float3(light.x + from_sources[3 * k], light.y + from_sources[3 * k + 1],
                          light.z + from_sources[3 * k + 2]);
    }
    color.x += r[3 * k] * light.x;
    color.y += r[3 * k + 1] * light.y;
    color.z += r[3 * k + 2] * light.z;
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
  ConicFactor conic;
  float x, y, log2_alpha;

  /// False when it cannot be seen.
  __device__ bool set(const GaussianGeometry& g, float opacity, const ObjectView& object, const DeviceView& view,
                      const ProjectOptions& options) {
    if (!project(g, object, view, options.blur_px2, p)) return false;
    const float alpha = options.antialias ? opacity * sqrtf(p.det_sharp / p.det) : opacity;
    if (!(alpha >= kAlphaMin)) return false;
    log2_alpha = log2f(alpha);
    conic = conic_factor(p);
    x = view.fx * p.view.x / p.view.z + view.cx;
    y = view.fy * p.view.y / p.view.z + view.cy;
    return true;
  }
};

/// False when the colour is not finite.
template <int kCoefficients, bool kSources>
__device__ bool shade(const DeviceGaussians& gaussians, int i, const float3 mean, const ObjectView& object,
                      const WorkspaceView& w, int b, float3& color) {
  if constexpr (kCoefficients > 0) {
    color = radiance_color<kCoefficients>(gaussians, i, mean, object);
  } else {
    color = transfer_color<kSources>(gaussians, i, mean, object, w, b);
    const ChannelsOfOne<float> albedo = parameters_of(gaussians).of(i, ParameterLayout::kAlbedo);
    if (!(bounded(albedo[0]) && bounded(albedo[1]) && bounded(albedo[2]))) return false;
  }
  return bounded(color.x) && bounded(color.y) && bounded(color.z);
}

/// Appends the intersections of a warp's Gaussians with the tiles of one view; true for those that have any.
__device__ bool emit(const Footprint& footprint, bool visible, int row, int b, float depth, const WorkspaceView& w) {
  const int tiles = w.tiles_x * w.tiles_y, lane = threadIdx.x & 31;
  std::uint32_t count = 0;
  if (visible) count = footprint.for_each_tile(w, [](int, std::uint32_t) {});
  // One atomic a warp: an inclusive scan gives each lane its place.
  std::uint32_t end = count;
  for (int step = 1; step < 32; step *= 2) {
    const std::uint32_t other = __shfl_up_sync(0xFFFFFFFFU, end, step);
    if (lane >= step) end += other;
  }
  std::uint32_t at = 0;
  if (lane == 31 && end > 0) at = atomicAdd(&w.counts->isects, end);
  at = __shfl_sync(0xFFFFFFFFU, at, 31) + end - count;
  if (count == 0) return false;
  const SortKey key(w);
  footprint.for_each_tile(w, [&](int tile, std::uint32_t patches) {
    if (at < w.isect_capacity) {
      w.isect_ids[0][at] = key.of(b * tiles + tile, depth, w.views[b].near_m);
      w.flatten_ids[0][at] = static_cast<std::uint32_t>(row) | patches << kPatchShift;
    }
    ++at;
  });
  return true;
}

/// Shading comes last, for what meets a tile, when little else is held in registers.
template <int kCoefficients, bool kSources>
__global__ void __launch_bounds__(kThreads, kSources ? 4 : 6)
    project_kernel(DeviceGaussians gaussians, WorkspaceView w, ProjectOptions options) {
  Lane<kThreads> lane;
  if (!lane.find(w)) return;
  const int i = lane.i;
  const bool present = lane.present();
  const float sign = lane.frozen ? -1.0F : 1.0F;
  GaussianGeometry g;
  float opacity = 0.0F;
  if (present) {
    g = load_geometry(parameters_of(gaussians), i);
    opacity = sigmoid(g.opacity_logit);
  }
  for (int b = 0; b < w.batch; ++b) {
    if (!lane.seen_by(b)) continue;
    const std::size_t at = static_cast<std::size_t>(b) * w.rows + lane.row;
    const ObjectView& object = w.object_views[b * w.object_count + lane.slot()];
    float depth = 0.0F;
    bool visible = false;
    {
      Seen seen;
      visible = present && seen.set(g, opacity, object, w.views[b], options);
      if (visible) depth = seen.p.view.z;
      Footprint footprint;
      visible = visible && footprint.set(seen.x, seen.y, seen.p, seen.conic, seen.log2_alpha, w);
      visible = emit(footprint, visible, lane.row, b, depth, w);
      if (visible) {
        w.projected_shape[2 * at] = make_float4(seen.x, seen.y, seen.log2_alpha, sign * seen.conic.uxx);
        *reinterpret_cast<float2*>(w.projected_shape + 2 * at + 1) = make_float2(sign * seen.conic.uxy, seen.conic.uyy);
      }
    }
    float3 color;
    if (visible && shade<kCoefficients, kSources>(gaussians, recomputed(i), g.mean, object, w, b, color)) {
      reinterpret_cast<float2*>(w.projected_shape + 2 * at + 1)[1] =
          make_float2(clamp_color(color.x), clamp_color(color.y));
      w.projected_tail[at] = make_float2(clamp_color(color.z), depth);
    } else if (visible) {
      // It meets a tile, but is not to be seen: what is blended with a weight of 0 must be finite, too.
      w.projected_shape[2 * at] = make_float4(0.0F, 0.0F, -INFINITY, sign * 0.0F);
      w.projected_shape[2 * at + 1] = make_float4(0.0F, 0.0F, 0.0F, 0.0F);
      w.projected_tail[at] = make_float2(0.0F, 0.0F);
    }
  }
}

}  // namespace

void launch_project(const DeviceGaussians& gaussians, const WorkspaceView& workspace, const ProjectOptions& options,
                    cudaStream_t stream) {
  check(cudaMemsetAsync(workspace.isect_ids[0], 0xFF, sizeof(std::uint64_t) * workspace.isect_capacity, stream),
        "clearing the intersections");
  launch_list_ranges(gaussians, workspace, options.blur_px2, stream);
  const unsigned blocks = Lane<kThreads>::blocks(workspace);
  if (blocks == 0) return;
  with_coefficients(gaussians.layout, [&](auto coefficients) {
    constexpr bool kTransfer = coefficients() == 0;
    if (kTransfer && workspace.source_room > 0) {
      project_kernel<coefficients(), kTransfer><<<blocks, kThreads, 0, stream>>>(gaussians, workspace, options);
    } else {
      project_kernel<coefficients(), false><<<blocks, kThreads, 0, stream>>>(gaussians, workspace, options);
    }
  });
  check(cudaGetLastError(), "projection");
}

}  // namespace splatbus::raster::cuda

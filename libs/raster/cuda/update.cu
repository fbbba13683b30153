#include "raster/cuda/adam_sink.cuh"
#include "raster/cuda/appearance_dispatch.h"
#include "raster/cuda/gradient_math.cuh"
#include "raster/cuda/kernels.h"
#include "raster/cuda/range_lanes.cuh"
#include "raster/cuda/source_light.cuh"
#include "raster/unmodelled.h"

namespace splatbus::raster::cuda {
namespace {

constexpr int kThreads = 128;

/// Plain gradients, for checks.
struct GradientSink {
  Channels<float> gradient;
  std::uint8_t* touched;
  int active_channels;

  template <class Item>
  __device__ void begin(const Item&, const float3) const {}
  template <int kChannels, bool kUnit = false>
  __device__ void put(int first, int spacing, int i, const float*, const float* values) const {
    for (int k = 0; k < kChannels; ++k) {
      const int channel = first + k * spacing;
      if (channel < active_channels) gradient(channel, i) += values[k];
    }
  }
};

/// What the update of one Gaussian needs to know.
struct Item {
  const DeviceGaussians& gaussians;
  const WorkspaceView& w;
  int i, row, slot;
  std::uint32_t views;  // bit b: blended into view b

  [[nodiscard]] __device__ std::size_t projected(int b) const { return static_cast<std::size_t>(b) * w.rows + row; }
  [[nodiscard]] __device__ const ObjectView& object(int b) const { return w.object_views[b * w.object_count + slot]; }
  [[nodiscard]] __device__ const float* gradient(int b) const {
    return w.projected_gradient + projected(b) * kGradientFloats;
  }
  /// Of colour c, zero where shading was clamped.
  [[nodiscard]] __device__ float color_gradient(int b, int c) const {
    const float4 shape = w.projected_shape[2 * projected(b) + 1];
    const float value = c == 0 ? shape.z : (c == 1 ? shape.w : w.projected_tail[projected(b)].x);
    return signbit(value) ? 0.0F : gradient(b)[6 + c];
  }
};

/// SH coefficients; adds to mean_gradient what comes through the view direction.
template <int kCoefficients, class Sink>
__device__ void update_radiance(const Item& item, const float3 mean, const Sink& sink, float* mean_gradient) {
#pragma unroll 1
  for (int c = 0; c < 3; ++c) {
    const int first = ParameterLayout::kAppearance + c;
    const ChannelsOfOne<float> p = parameters_of(item.gaussians).of(item.i, first);
    float f[kCoefficients], sums[kCoefficients] = {};
#pragma unroll
    for (int k = 0; k < kCoefficients; ++k) f[k] = p[3 * k];
#pragma unroll 1
    for (int b = 0; b < item.w.batch; ++b) {
      if ((item.views >> b & 1U) == 0) continue;
      const float g = item.color_gradient(b, c);
      const ObjectView& object = item.object(b);
      float3 d = make_float3(mean.x - object.camera_in_object[0], mean.y - object.camera_in_object[1],
                             mean.z - object.camera_in_object[2]);
      const float inv = rsqrtf(fmaxf(d.x * d.x + d.y * d.y + d.z * d.z, 1e-20F));
      d = make_float3(d.x * inv, d.y * inv, d.z * inv);
      float y[kCoefficients];
      sh_basis<kCoefficients>(d, y);
#pragma unroll
      for (int k = 0; k < kCoefficients; ++k) sums[k] += g * y[k];
      const float3 along = sh_direction_gradient<kCoefficients>(d, f);
      const float radial = along.x * d.x + along.y * d.y + along.z * d.z;
      mean_gradient[0] += g * inv * (along.x - radial * d.x);
      mean_gradient[1] += g * inv * (along.y - radial * d.y);
      mean_gradient[2] += g * inv * (along.z - radial * d.z);
    }
    constexpr int kHalf = kCoefficients / 2;
    if constexpr (kHalf > 0) sink.template put<kHalf>(first, 3, item.i, f, sums);
    sink.template put<kCoefficients - kHalf>(first + 3 * kHalf, 3, item.i, f + kHalf, sums + kHalf);
  }
}

template <int kChannels, bool kUnit = false, class Sink>
__device__ void put_channels(const Item& item, const Sink& sink, int first, const float* gradient) {
  float value[kChannels];
#pragma unroll
  for (int k = 0; k < kChannels; ++k) {
    value[k] = parameters_of(item.gaussians)(first + k, item.i);
  }
  sink.template put<kChannels, kUnit>(first, 1, item.i, value, gradient);
}

/// The mean gets nothing through a light: geometry is not to move in order to explain brightness.
template <bool kSources, class Sink>
__device__ void update_transfer(const Item& item, const float3 mean, const Sink& sink, bool residual) {
  const float3 n = load_normal(normals_of(item.gaussians), item.i);
  float albedo[3] = {0.0F, 0.0F, 0.0F}, sums[27] = {};
  for (int b = 0; b < item.w.batch; ++b) {
    if ((item.views >> b & 1U) == 0) continue;
    const float g[3] = {item.color_gradient(b, 0), item.color_gradient(b, 1), item.color_gradient(b, 2)};
    const ObjectView& object = item.object(b);
    const float visibility = visibility_of(item.gaussians, item.w.views[b], item.i);
    const float3 response = diffuse_response(object, n, visibility);
    const float direct[3] = {response.x, response.y, response.z};
    for (int c = 0; c < 3; ++c) albedo[c] += g[c] * direct[c] + item.gradient(b)[9 + c];
    if constexpr (kSources) {
      for_each_source(item.w, b, object, mean, item.i, [&](const float3 irradiance, const float3 to_light) {
        const float of_light[3] = {g[0] * irradiance.x, g[1] * irradiance.y, g[2] * irradiance.z};
        const float cosine = facing(n, to_light);
#pragma unroll
        for (int c = 0; c < 3; ++c) albedo[c] += cosine * of_light[c];
        if (!residual) return;
        float y[9];
        sh_basis<9>(to_light, y);
#pragma unroll
        for (int k = 0; k < 27; ++k) sums[k] += y[k / 3] * of_light[k % 3];
      });
    }
    if (!residual) continue;
    float sun[9];
    sh_basis<9>(make_float3(object.sun_direction[0], object.sun_direction[1], object.sun_direction[2]), sun);
#pragma unroll
    for (int k = 0; k < 9; ++k) {
      const float3 light = residual_light(object, k, sun[k], visibility);
      sums[3 * k] += g[0] * light.x;
      sums[3 * k + 1] += g[1] * light.y;
      sums[3 * k + 2] += g[2] * light.z;
    }
  }
  put_channels<3, true>(item, sink, ParameterLayout::kAlbedo, albedo);
  if (!residual) return;
#pragma unroll
  for (int k = 0; k < 27; k += 9) put_channels<9>(item, sink, ParameterLayout::kResidual + k, sums + k);
}

/// With kExtra also what comes through depth, and the statistics.
template <bool kExtra, class Sink>
__device__ void update_geometry(const Item& item, const GaussianGeometry& g, const ProjectOptions& options,
                                const Sink& sink, const float* mean_gradient, const ScreenStatistics& statistics) {
  GeometryGradient sums;
  float norm2d = 0.0F;
  for (int b = 0; b < item.w.batch; ++b) {
    if ((item.views >> b & 1U) == 0) continue;
    const auto* from = reinterpret_cast<const float4*>(item.gradient(b));
    const float4 low = from[0], high = from[1];
    const float r[6] = {low.x, low.y, low.z, low.w, high.x, high.y};
    Projection p;
    if (!project(g, item.object(b), item.w.views[b], options.blur_px2, p)) continue;
    const float2 of_center = add_view(p, item.object(b), item.w.views[b], r, options.antialias, sums);
    if constexpr (kExtra) {
      const float x = 0.5F * item.w.width * of_center.x, y = 0.5F * item.w.height * of_center.y;
      norm2d += sqrtf(x * x + y * y);
      if (item.w.projected_depth_gradient == nullptr) continue;
      const float of_depth = item.w.projected_depth_gradient[item.projected(b)];
      for (int k = 0; k < 3; ++k) sums.mean[k] += item.object(b).view_from_object[8 + k] * of_depth;
    }
  }
  if constexpr (kExtra) {
    if (statistics.mean2d_norm != nullptr) {
      statistics.mean2d_norm[item.i] += norm2d;
      if (statistics.steps != nullptr) statistics.steps[item.i] += 1;
    }
  }
  const float norm = sqrtf(g.rotation.x * g.rotation.x + g.rotation.y * g.rotation.y + g.rotation.z * g.rotation.z +
                           g.rotation.w * g.rotation.w);
  const float4 q = quaternion_gradient(g.rotation, norm, sums.rotation);
  const float all[11] = {sums.mean[0] + mean_gradient[0],
                         sums.mean[1] + mean_gradient[1],
                         sums.mean[2] + mean_gradient[2],
                         sums.log_scale[0],
                         sums.log_scale[1],
                         sums.log_scale[2],
                         q.x,
                         q.y,
                         q.z,
                         q.w,
                         sums.log_alpha * (1.0F - sigmoid(g.opacity_logit))};
  const float value[11] = {g.mean.x,     g.mean.y,     g.mean.z,     g.log_scale.x, g.log_scale.y,  g.log_scale.z,
                           g.rotation.x, g.rotation.y, g.rotation.z, g.rotation.w,  g.opacity_logit};
  sink.template put<11>(0, 1, item.i, value, all);
}

/// For the next step.
template <bool kExtra>
__device__ void clear_gradients(const Item& item) {
  for (int b = 0; b < item.w.batch; ++b) {
    if ((item.views >> b & 1U) == 0) continue;
    auto* gradient = reinterpret_cast<float4*>(item.w.projected_gradient + item.projected(b) * kGradientFloats);
    for (int k = 0; k < kGradientFloats / 4; ++k) gradient[k] = make_float4(0.0F, 0.0F, 0.0F, 0.0F);
    item.w.projected_visible[item.projected(b)] = 0;
    if constexpr (kExtra) {
      if (item.w.projected_depth_gradient != nullptr) item.w.projected_depth_gradient[item.projected(b)] = 0.0F;
    }
  }
}

/// Those of `views` that show no sky where the middle of a Gaussian lies.
__device__ std::uint32_t views_without_sky(const WorkspaceView& w, std::uint32_t views, int row) {
  std::uint32_t hidden = 0;
  for (int b = 0; b < w.batch; ++b) {
    const float* const depth = w.surface_depths[b];
    if ((views >> b & 1U) == 0 || depth == nullptr) continue;
    const float4 shape = w.projected_shape[2 * (static_cast<std::size_t>(b) * w.rows + row)];
    // Where it lies, or nearest to that in the picture.
    const int x = static_cast<int>(fminf(fmaxf(shape.x, 0.0F), static_cast<float>(w.width - 1)));
    const int y = static_cast<int>(fminf(fmaxf(shape.y, 0.0F), static_cast<float>(w.height - 1)));
    hidden |= (shows_surface(depth[static_cast<std::size_t>(y) * w.width + x]) ? 1U : 0U) << b;
  }
  return hidden;
}

template <class Sink, int kCoefficients, bool kExtra, bool kSources>
__global__ void __launch_bounds__(kThreads, 4)
    update_kernel(DeviceGaussians gaussians, WorkspaceView w, ProjectOptions options, Sink sink, bool residual,
                  ScreenStatistics statistics) {
  Lane<kThreads> lane;
  if (!lane.find(w) || lane.frozen || !lane.present()) return;
  const int i = lane.i;
  std::uint32_t views = 0;
  for (int b = 0; b < w.batch; ++b) {
    views |= static_cast<std::uint32_t>(w.projected_visible[static_cast<std::size_t>(b) * w.rows + lane.row]) << b;
  }
  if (views == 0) return;
  if (lane.slot() == w.far_slot && w.surface_depths != nullptr) {
    const std::uint32_t hidden = views_without_sky(w, views, lane.row);
    clear_gradients<kExtra>(Item{gaussians, w, i, lane.row, lane.slot(), hidden});
    views &= ~hidden;
    if (views == 0) return;
  }
  const Item item{gaussians, w, i, lane.row, lane.slot(), views};
  if constexpr (std::is_same_v<Sink, GradientSink>) sink.touched[i] = 1;
  if (!is_frozen(gaussians, i)) {
    const GaussianGeometry g = load_geometry(parameters_of(gaussians), i);
    sink.begin(item, g.mean);
    float mean_gradient[3] = {0.0F, 0.0F, 0.0F};
    if constexpr (kCoefficients == 0) {
      update_transfer<kSources>(item, g.mean, sink, residual);
    } else {
      update_radiance<kCoefficients>(item, g.mean, sink, mean_gradient);
    }
    update_geometry<kExtra>(item, g, options, sink, mean_gradient, statistics);
  }
  clear_gradients<kExtra>(item);
}

template <class Sink>
void launch_with(const DeviceGaussians& gaussians, const WorkspaceView& workspace, const ProjectOptions& project,
                 const Sink& sink, const ScreenStatistics& statistics, cudaStream_t stream) {
  const unsigned blocks = Lane<kThreads>::blocks(workspace);
  if (blocks == 0) return;
  const bool residual = sink.active_channels > ParameterLayout::kResidual;
  with_coefficients(gaussians.layout, [&](auto coefficients) {
    constexpr bool kTransfer = coefficients() == 0;
    const auto launch = [&](auto extra, auto sources) {
      update_kernel<Sink, coefficients(), extra(), sources()>
          <<<blocks, kThreads, 0, stream>>>(gaussians, workspace, project, sink, residual, statistics);
    };
    const auto launch_lit = [&](auto extra) {
      kTransfer&& workspace.source_room > 0 ? launch(extra, std::bool_constant<kTransfer>{})
                                            : launch(extra, std::false_type{});
    };
    const bool extra = workspace.projected_depth_gradient != nullptr || statistics.mean2d_norm != nullptr;
    extra ? launch_lit(std::true_type{}) : launch_lit(std::false_type{});
  });
  check(cudaGetLastError(), "update");
}

int active(const DeviceGaussians& gaussians, int active_channels) {
  return active_channels > 0 ? active_channels : gaussians.layout.channels();
}

}  // namespace

void launch_update(const DeviceGaussians& gaussians, const WorkspaceView& workspace, const ProjectOptions& project,
                   const OptimizerState& state, const AdamOptions& adam, const ScreenStatistics& statistics,
                   cudaStream_t stream) {
  launch_with(gaussians, workspace, project,
              AdamSink{.gaussians = gaussians,
                       .state = state,
                       .options = adam,
                       .active_channels = active(gaussians, adam.active_channels)},
              statistics, stream);
}

void launch_gradient(const DeviceGaussians& gaussians, const WorkspaceView& workspace, const ProjectOptions& project,
                     float* gradient, std::uint8_t* touched, const ScreenStatistics& statistics, int active_channels,
                     cudaStream_t stream) {
  launch_with(gaussians, workspace, project,
              GradientSink{.gradient = {gradient, gaussians.has_pages() ? gaussians.count : gaussians.stride},
                           .touched = touched,
                           .active_channels = active(gaussians, active_channels)},
              statistics, stream);
}

}  // namespace splatbus::raster::cuda

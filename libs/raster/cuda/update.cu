#include "raster/cuda/footprint.cuh"
#include "raster/cuda/kernels.h"
#include "raster/cuda/projection_math.cuh"

namespace splatbus::raster::cuda {
namespace {

constexpr int kThreads = 128;
constexpr float kLog2E = 1.4426950408889634F;

/// Where gradients go: Adam in place (Kingma and Ba 2015), each Gaussian with a step count of its own.
struct AdamSink {
  DeviceGaussians gaussians;
  OptimizerState state;
  AdamOptions options;
  float correction1 = 1.0F, correction2 = 1.0F;

  __device__ void begin(int i) {
    const auto step = static_cast<float>(state.steps[i] + 1);
    correction1 = 1.0F / (1.0F - exp2f(step * log2f(options.beta1)));
    correction2 = 1.0F / (1.0F - exp2f(step * log2f(options.beta2)));
  }
  __device__ void finish(int i) const { state.steps[i] += 1; }
  __device__ void put(int channel, int i, float gradient) const {
    const std::int64_t at = channel * gaussians.stride + i;
    const float first = options.beta1 * state.first[at] + (1.0F - options.beta1) * gradient;
    const float second = options.beta2 * state.second[at] + (1.0F - options.beta2) * gradient * gradient;
    state.first[at] = first;
    state.second[at] = second;
    gaussians.parameters[at] -=
        options.learning_rate[channel] * first * correction1 / (sqrtf(second * correction2) + options.epsilon);
  }
};

/// Plain gradients, for checks.
struct GradientSink {
  float* gradient;
  std::int64_t stride;

  __device__ void begin(int) {}
  __device__ void finish(int) const {}
  __device__ void put(int channel, int i, float value) const { gradient[channel * stride + i] += value; }
};

__device__ bool is_trained(const DeviceGaussians& gaussians, const WorkspaceView& w, int i) {
  if (gaussians.flags != nullptr && (gaussians.flags[i] & kFrozen) != 0) return false;
  for (int b = 0; b < w.batch; ++b) {
    if (w.record_shading[static_cast<std::size_t>(b) * w.count + i].y > 0.0F) return true;
  }
  return false;
}

/// Colour gradient of record r, zero where shading was clamped.
__device__ float color_gradient(const WorkspaceView& w, std::size_t record, int c) {
  const float4 shading = w.record_shading[record];
  if (!(shading.y > 0.0F)) return 0.0F;
  const float value = c == 0 ? shading.z : (c == 1 ? shading.w : w.record_tail[record].x);
  return value > 0.0F ? w.record_gradient[record * kGradientFloats + 6 + c] : 0.0F;
}

/// One thread a Gaussian and colour. Leaves in direction_gradient what the mean gets through the view direction.
template <class Sink>
__global__ void __launch_bounds__(kThreads)
    radiance_update_kernel(DeviceGaussians gaussians, WorkspaceView w, Sink sink) {
  const int i = blockIdx.x * kThreads + threadIdx.x, c = blockIdx.y;
  if (i >= w.count) return;
  float3 mean_gradient = make_float3(0.0F, 0.0F, 0.0F);
  if (is_trained(gaussians, w, i)) {
    const int coefficients = gaussians.layout.sh_coefficients();
    const float* p = gaussians.parameters + (ParameterLayout::kAppearance + c) * gaussians.stride + i;
    float f[16], sums[16];
#pragma unroll
    for (int k = 0; k < 16; ++k) {
      f[k] = k < coefficients ? p[3 * k * gaussians.stride] : 0.0F;
      sums[k] = 0.0F;
    }
    const float* mean = gaussians.parameters + i;
    const float3 m = make_float3(mean[0], mean[gaussians.stride], mean[2 * gaussians.stride]);
    const int slot = w.object_slot != nullptr ? w.object_slot[i] : 0;
    for (int b = 0; b < w.batch; ++b) {
      const float g = color_gradient(w, static_cast<std::size_t>(b) * w.count + i, c);
      if (g == 0.0F) continue;
      const ObjectView& object = w.object_views[b * w.object_count + slot];
      float3 d = make_float3(m.x - object.camera_in_object[0], m.y - object.camera_in_object[1],
                             m.z - object.camera_in_object[2]);
      const float inv = rsqrtf(fmaxf(d.x * d.x + d.y * d.y + d.z * d.z, 1e-20F));
      d = make_float3(d.x * inv, d.y * inv, d.z * inv);
      float y[16];
      sh_basis(d, coefficients, y);
#pragma unroll
      for (int k = 0; k < 16; ++k) {
        if (k < coefficients) sums[k] += g * y[k];
      }
      const float3 along = sh_direction_gradient(d, coefficients, f);
      const float radial = along.x * d.x + along.y * d.y + along.z * d.z;
      mean_gradient.x += g * inv * (along.x - radial * d.x);
      mean_gradient.y += g * inv * (along.y - radial * d.y);
      mean_gradient.z += g * inv * (along.z - radial * d.z);
    }
    sink.begin(i);
#pragma unroll
    for (int k = 0; k < 16; ++k) {
      if (k < coefficients) sink.put(ParameterLayout::kAppearance + 3 * k + c, i, sums[k]);
    }
  }
  float* out = w.direction_gradient + static_cast<std::size_t>(3 * c) * w.count + i;
  out[0] = mean_gradient.x;
  out[w.count] = mean_gradient.y;
  out[2 * static_cast<std::size_t>(w.count)] = mean_gradient.z;
}

template <class Sink>
__global__ void __launch_bounds__(kThreads)
    transfer_update_kernel(DeviceGaussians gaussians, WorkspaceView w, Sink sink, bool residual) {
  const int i = blockIdx.x * kThreads + threadIdx.x;
  if (i >= w.count || !is_trained(gaussians, w, i)) return;
  const float3 n = make_float3(gaussians.normal[i], gaussians.normal[gaussians.stride + i],
                               gaussians.normal[2 * gaussians.stride + i]);
  const float visibility = gaussians.visibility[i];
  const int slot = w.object_slot != nullptr ? w.object_slot[i] : 0;
  float albedo[3] = {0.0F, 0.0F, 0.0F}, sums[27] = {};
  for (int b = 0; b < w.batch; ++b) {
    const std::size_t record = static_cast<std::size_t>(b) * w.count + i;
    const float g[3] = {color_gradient(w, record, 0), color_gradient(w, record, 1), color_gradient(w, record, 2)};
    const ObjectView& object = w.object_views[b * w.object_count + slot];
    const float3 response = diffuse_response(object, n, visibility);
    const float direct[3] = {response.x, response.y, response.z};
    for (int c = 0; c < 3; ++c) {
      albedo[c] += g[c] * direct[c];
      if (w.albedo != nullptr && w.record_shading[record].y > 0.0F) {
        albedo[c] += w.record_gradient[record * kGradientFloats + 9 + c];
      }
    }
    if (!residual) continue;
    float sun[9];
    sh_basis(make_float3(object.sun_direction[0], object.sun_direction[1], object.sun_direction[2]), 9, sun);
#pragma unroll
    for (int k = 0; k < 9; ++k) {
      const float3 light = residual_light(object, k, sun[k], visibility);
      sums[3 * k] += g[0] * light.x;
      sums[3 * k + 1] += g[1] * light.y;
      sums[3 * k + 2] += g[2] * light.z;
    }
  }
  sink.begin(i);
  for (int c = 0; c < 3; ++c) sink.put(ParameterLayout::kAlbedo + c, i, albedo[c]);
  if (!residual) return;
#pragma unroll
  for (int k = 0; k < 27; ++k) sink.put(ParameterLayout::kResidual + k, i, sums[k]);
}

/// Gradients of one Gaussian's geometry, summed over views.
struct GeometryGradient {
  float mean[3] = {}, log_scale[3] = {}, rotation[9] = {};  // rotation: of the matrix R
  float opacity = 0.0F;
};

/// Adds the gradient through one view; `r` is the record's gradient.
__device__ void add_view(const Projection& p, const ObjectView& object, const DeviceView& view, const float* r,
                         float opacity, bool antialias, GeometryGradient& out) {
  const float inv_det = 1.0F / p.det;
  const float g_c = -0.5F * kLog2E * r[2], g_b = kLog2E * r[3], g_a = -0.5F * kLog2E * r[4];
  const float s = (g_c * p.c + g_b * p.b + g_a * p.a) * inv_det * inv_det;
  float d_a = inv_det * g_a - s * p.c, d_c = inv_det * g_c - s * p.a, d_b = inv_det * g_b + 2.0F * s * p.b;
  out.opacity += r[5] * p.compensation;
  float3 d_cross = make_float3(0.0F, 0.0F, 0.0F);
  if (antialias && p.compensation > 1e-6F) {
    const float d_compensation = r[5] * opacity;
    const float k = 0.5F * d_compensation * p.compensation * inv_det;
    d_a -= k * p.c;
    d_c -= k * p.a;
    d_b += 2.0F * k * p.b;
    const float d_sharp = d_compensation * inv_det / p.compensation;  // 2 dL/d(det_sharp)
    d_cross = make_float3(d_sharp * p.cross.x, d_sharp * p.cross.y, d_sharp * p.cross.z);
  }
  const float* u = p.jwm;
  const float* v = p.jwm + 3;
  float d_u[3], d_v[3];
  for (int k = 0; k < 3; ++k) {
    d_u[k] = 2.0F * d_a * u[k] + d_b * v[k];
    d_v[k] = 2.0F * d_c * v[k] + d_b * u[k];
  }
  d_u[0] += v[1] * d_cross.z - v[2] * d_cross.y;
  d_u[1] += v[2] * d_cross.x - v[0] * d_cross.z;
  d_u[2] += v[0] * d_cross.y - v[1] * d_cross.x;
  d_v[0] += d_cross.y * u[2] - d_cross.z * u[1];
  d_v[1] += d_cross.z * u[0] - d_cross.x * u[2];
  d_v[2] += d_cross.x * u[1] - d_cross.y * u[0];

  const float scale[3] = {p.scale.x, p.scale.y, p.scale.z};
  float d_jw[6];
  for (int k = 0; k < 3; ++k) {
    d_jw[k] = d_u[0] * p.m[3 * k] + d_u[1] * p.m[3 * k + 1] + d_u[2] * p.m[3 * k + 2];
    d_jw[3 + k] = d_v[0] * p.m[3 * k] + d_v[1] * p.m[3 * k + 1] + d_v[2] * p.m[3 * k + 2];
    for (int c = 0; c < 3; ++c) {
      const float d_m = p.jw[k] * d_u[c] + p.jw[3 + k] * d_v[c];
      out.log_scale[c] += d_m * p.m[3 * k + c];
      out.rotation[3 * k + c] += d_m * scale[c];
    }
  }
  const float* w = object.view_from_object;
  const float inv_z = 1.0F / p.view.z, jx = view.fx * inv_z, jy = view.fy * inv_z;
  float d_jx = 0.0F, d_jy = 0.0F, d_xz = 0.0F, d_yz = 0.0F;
  for (int k = 0; k < 3; ++k) {
    d_jx += d_jw[k] * (w[k] - p.x_over_z * w[8 + k]);
    d_jy += d_jw[3 + k] * (w[4 + k] - p.y_over_z * w[8 + k]);
    d_xz -= jx * d_jw[k] * w[8 + k];
    d_yz -= jy * d_jw[3 + k] * w[8 + k];
  }
  if (p.clamped_x) d_xz = 0.0F;
  if (p.clamped_y) d_yz = 0.0F;
  const float d_x_ratio = d_xz + view.fx * r[0], d_y_ratio = d_yz + view.fy * r[1];
  const float d_view[3] = {d_x_ratio * inv_z, d_y_ratio * inv_z,
                           -inv_z * (d_jx * jx + d_jy * jy + (d_x_ratio * p.view.x + d_y_ratio * p.view.y) * inv_z)};
  for (int k = 0; k < 3; ++k) out.mean[k] += w[k] * d_view[0] + w[4 + k] * d_view[1] + w[8 + k] * d_view[2];
}

/// Gradient of the stored quaternion, given that of the rotation matrix of its unit quaternion.
__device__ float4 quaternion_gradient(const float4 stored, float norm, const float* d) {
  const float inv = 1.0F / norm;
  const float w = stored.x * inv, x = stored.y * inv, y = stored.z * inv, z = stored.w * inv;
  const float4 g = make_float4(
      2.0F * (-z * d[1] + y * d[2] + z * d[3] - x * d[5] - y * d[6] + x * d[7]),
      2.0F * (y * d[1] + z * d[2] + y * d[3] - 2.0F * x * d[4] - w * d[5] + z * d[6] + w * d[7] - 2.0F * x * d[8]),
      2.0F * (-2.0F * y * d[0] + x * d[1] + w * d[2] + x * d[3] + z * d[5] - w * d[6] + z * d[7] - 2.0F * y * d[8]),
      2.0F * (-2.0F * z * d[0] - w * d[1] + x * d[2] + w * d[3] - 2.0F * z * d[4] + y * d[5] + x * d[6] + y * d[7]));
  const float radial = g.x * w + g.y * x + g.z * y + g.w * z;
  return make_float4(inv * (g.x - radial * w), inv * (g.y - radial * x), inv * (g.z - radial * y),
                     inv * (g.w - radial * z));
}

template <class Sink>
__global__ void __launch_bounds__(kThreads)
    geometry_update_kernel(DeviceGaussians gaussians, WorkspaceView w, ProjectOptions project_options, Sink sink) {
  const int i = blockIdx.x * kThreads + threadIdx.x;
  if (i >= w.count || !is_trained(gaussians, w, i)) return;
  const GaussianGeometry g = load_geometry(gaussians.parameters, gaussians.stride, i);
  const float opacity = sigmoid(g.opacity_logit);
  const int slot = w.object_slot != nullptr ? w.object_slot[i] : 0;
  GeometryGradient sums;
  Projection p;
  for (int b = 0; b < w.batch; ++b) {
    const std::size_t record = static_cast<std::size_t>(b) * w.count + i;
    if (!(w.record_shading[record].y > 0.0F)) continue;
    const ObjectView& object = w.object_views[b * w.object_count + slot];
    project(g, object, w.views[b], project_options.blur_px2, project_options.antialias, p);
    const float4* from = reinterpret_cast<const float4*>(w.record_gradient + record * kGradientFloats);
    const float4 low = from[0], high = from[1];
    const float r[6] = {low.x, low.y, low.z, low.w, high.x, high.y};
    add_view(p, object, w.views[b], r, opacity, project_options.antialias, sums);
  }
  if (gaussians.layout.appearance == Appearance::Radiance) {
    for (int c = 0; c < 3; ++c) {
      for (int k = 0; k < 3; ++k)
        sums.mean[k] += w.direction_gradient[static_cast<std::size_t>(3 * c + k) * w.count + i];
    }
  }
  const float norm = sqrtf(g.rotation.x * g.rotation.x + g.rotation.y * g.rotation.y + g.rotation.z * g.rotation.z +
                           g.rotation.w * g.rotation.w);
  const float4 q = quaternion_gradient(g.rotation, norm, sums.rotation);
  sink.begin(i);
  for (int k = 0; k < 3; ++k) {
    sink.put(ParameterLayout::kMean + k, i, sums.mean[k]);
    sink.put(ParameterLayout::kLogScale + k, i, sums.log_scale[k]);
  }
  sink.put(ParameterLayout::kRotation, i, q.x);
  sink.put(ParameterLayout::kRotation + 1, i, q.y);
  sink.put(ParameterLayout::kRotation + 2, i, q.z);
  sink.put(ParameterLayout::kRotation + 3, i, q.w);
  sink.put(ParameterLayout::kOpacityLogit, i, sums.opacity * opacity * (1.0F - opacity));
  sink.finish(i);
}

template <class Sink>
void launch_with(const DeviceGaussians& gaussians, const WorkspaceView& workspace, const ProjectOptions& project,
                 Sink sink, int active_channels, cudaStream_t stream) {
  const auto blocks = static_cast<unsigned>((workspace.count + kThreads - 1) / kThreads);
  if (blocks == 0) return;
  // Appearance first: the mean's gradient needs what it leaves, and it reads the mean as the forward pass did.
  if (gaussians.layout.appearance == Appearance::Radiance) {
    radiance_update_kernel<<<dim3(blocks, 3), kThreads, 0, stream>>>(gaussians, workspace, sink);
  } else {
    const bool residual = active_channels == 0 || active_channels > ParameterLayout::kResidual;
    transfer_update_kernel<<<blocks, kThreads, 0, stream>>>(gaussians, workspace, sink, residual);
  }
  geometry_update_kernel<<<blocks, kThreads, 0, stream>>>(gaussians, workspace, project, sink);
  check(cudaGetLastError(), "update");
}

}  // namespace

void launch_update(const DeviceGaussians& gaussians, const WorkspaceView& workspace, const ProjectOptions& project,
                   const OptimizerState& state, const AdamOptions& adam, cudaStream_t stream) {
  launch_with(gaussians, workspace, project, AdamSink{.gaussians = gaussians, .state = state, .options = adam},
              adam.active_channels, stream);
}

void launch_gradient(const DeviceGaussians& gaussians, const WorkspaceView& workspace, const ProjectOptions& project,
                     float* gradient, int active_channels, cudaStream_t stream) {
  launch_with(gaussians, workspace, project, GradientSink{.gradient = gradient, .stride = gaussians.stride},
              active_channels, stream);
}

}  // namespace splatbus::raster::cuda

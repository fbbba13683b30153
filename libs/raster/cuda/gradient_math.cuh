#pragma once

#include "raster/cuda/projection_math.cuh"

namespace splatbus::raster::cuda {

/// Gradients of one Gaussian's geometry, summed over views.
struct GeometryGradient {
  float mean[3] = {}, log_scale[3] = {}, rotation[9] = {};  // rotation: of the matrix R
  float log_alpha = 0.0F;                                   // of ln(opacity)
};

/// Adds the gradient through one view; `r` is what blending summed for the projected Gaussian: s dx, s dy, s dx^2, s dx
/// dy, s dy^2 and s. Returns that of the projected mean, a pixel.
__device__ inline float2 add_view(const Projection& p, const ObjectView& object, const DeviceView& view, const float* r,
                                  bool antialias, GeometryGradient& out) {
  constexpr float kInverseScale2 = 1.3862943611198906F;  // kConicScale^-2
  constexpr float kHalf = 0.5F * kInverseScale2 * kInverseScale2;
  const ConicFactor q = conic_factor(p);
  // dL/d(x, y) = U^T sum s (u, v); dL/dcovariance = 1/2 sum s (Q d)(Q d)^T with Q the inverse covariance, Q d = U^T
  // (u, v).
  const float su = q.uxx * r[0] + q.uxy * r[1], sv = q.uyy * r[1];
  const float g_x = kInverseScale2 * q.uxx * su, g_y = kInverseScale2 * (q.uxy * su + q.uyy * sv);
  const float suu = q.uxx * (q.uxx * r[2] + 2.0F * q.uxy * r[3]) + q.uxy * q.uxy * r[4];
  const float suv = q.uyy * (q.uxx * r[3] + q.uxy * r[4]), svv = q.uyy * q.uyy * r[4];
  float d_a = kHalf * q.uxx * q.uxx * suu, d_b = 2.0F * kHalf * q.uxx * (q.uxy * suu + q.uyy * suv);
  float d_c = kHalf * (q.uxy * (q.uxy * suu + 2.0F * q.uyy * suv) + q.uyy * q.uyy * svv);
  out.log_alpha += r[5];
  float3 d_cross = make_float3(0.0F, 0.0F, 0.0F);
  if (antialias) {
    // ln alpha holds half of ln(det_sharp / det), and det_sharp = |cross|^2.
    const float by_det = r[5] / p.det, by_sharp = r[5] / p.det_sharp;
    d_a -= 0.5F * by_det * p.c;
    d_c -= 0.5F * by_det * p.a;
    d_b += by_det * p.b;
    d_cross = make_float3(by_sharp * p.cross.x, by_sharp * p.cross.y, by_sharp * p.cross.z);
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
  const float d_x_ratio = d_xz + view.fx * g_x, d_y_ratio = d_yz + view.fy * g_y;
  const float d_view[3] = {d_x_ratio * inv_z, d_y_ratio * inv_z,
                           -inv_z * (d_jx * jx + d_jy * jy + (d_x_ratio * p.view.x + d_y_ratio * p.view.y) * inv_z)};
  for (int k = 0; k < 3; ++k) out.mean[k] += w[k] * d_view[0] + w[4 + k] * d_view[1] + w[8 + k] * d_view[2];
  return make_float2(g_x, g_y);
}

/// Gradient of the stored quaternion, given that of the rotation matrix of its unit quaternion.
__device__ inline float4 quaternion_gradient(const float4 stored, float norm, const float* d) {
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

}  // namespace splatbus::raster::cuda

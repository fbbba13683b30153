#pragma once

#include "raster/cuda/gaussian_channels.cuh"

namespace splatbus::raster::cuda {

/// A Gaussian's parameters in registers.
struct GaussianGeometry {
  float3 mean;
  float3 log_scale;
  float4 rotation;  // w x y z as stored, not normalised
  float opacity_logit;
};

__device__ inline GaussianGeometry load_geometry(const Channels<float>& parameters, int i) {
  const ChannelsOfOne<float> p = parameters.of(i);
  GaussianGeometry g;
  g.mean = make_float3(p[0], p[1], p[2]);
  g.log_scale = make_float3(p[3], p[4], p[5]);
  g.rotation = make_float4(p[6], p[7], p[8], p[9]);
  g.opacity_logit = p[10];
  return g;
}

/// What projection leaves for the backward pass to compute again.
struct Projection {
  float3 view;               // mean in the camera's frame
  float x_over_z, y_over_z;  // clamped
  bool clamped_x, clamped_y;
  float jw[6];  // 2x3: J W, pixel displacement by object-frame displacement
  float m[9];   // R S, so that the covariance is m m^T
  float r[9];   // R
  float3 scale;
  float norm;            // of the stored quaternion
  float jwm[6];          // 2x3: J W R S
  float a, b, c;         // projected covariance, blur added
  float3 cross;          // of the rows of jwm
  float det, det_sharp;  // of the covariance with and without blur
};

/// Squared distances are in units in which alpha = 2^(log2_alpha - u^2 - v^2): (x / this)^2 = 2 ln 2 x^2.
constexpr float kConicScale = 0.8493218002880191F;  // sqrt(log2(e) / 2)

/// The factor U of the inverse covariance, U^T U, times kConicScale: u = uxx dx + uxy dy, v = uyy dy. It comes from
/// the Schur complement, without cancellation.
struct ConicFactor {
  float uxx, uxy, uyy;
};

__device__ inline ConicFactor conic_factor(const Projection& p) {
  const float inv_root_c = 1.0F / sqrtf(p.c), inv_root_det = 1.0F / sqrtf(p.det);
  return {kConicScale * sqrtf(p.c) * inv_root_det, -kConicScale * p.b * inv_root_c * inv_root_det,
          kConicScale * inv_root_c};
}

__device__ inline void rotation_matrix(const float4 q, float* r) {
  r[0] = 1.0F - 2.0F * (q.z * q.z + q.w * q.w);
  r[1] = 2.0F * (q.y * q.z - q.x * q.w);
  r[2] = 2.0F * (q.y * q.w + q.x * q.z);
  r[3] = 2.0F * (q.y * q.z + q.x * q.w);
  r[4] = 1.0F - 2.0F * (q.y * q.y + q.w * q.w);
  r[5] = 2.0F * (q.z * q.w - q.x * q.y);
  r[6] = 2.0F * (q.y * q.w - q.x * q.z);
  r[7] = 2.0F * (q.z * q.w + q.x * q.y);
  r[8] = 1.0F - 2.0F * (q.y * q.y + q.z * q.z);
}

/// Local affine approximation (Zwicker et al. 2001). False when the Gaussian is to be culled: behind the near plane,
/// not finite, or degenerate.
__device__ inline bool project(const GaussianGeometry& g, const ObjectView& object, const DeviceView& view, float blur,
                               Projection& out) {
  const float* v = object.view_from_object;
  out.view = make_float3(v[0] * g.mean.x + v[1] * g.mean.y + v[2] * g.mean.z + v[3],
                         v[4] * g.mean.x + v[5] * g.mean.y + v[6] * g.mean.z + v[7],
                         v[8] * g.mean.x + v[9] * g.mean.y + v[10] * g.mean.z + v[11]);
  if (!(out.view.z > view.near_m)) return false;
  const float inv_z = 1.0F / out.view.z;
  const float tx = out.view.x * inv_z, ty = out.view.y * inv_z;
  out.x_over_z = fminf(fmaxf(tx, view.limit_x_low), view.limit_x_high);
  out.y_over_z = fminf(fmaxf(ty, view.limit_y_low), view.limit_y_high);
  out.clamped_x = out.x_over_z != tx;
  out.clamped_y = out.y_over_z != ty;
  const float jx = view.fx * inv_z, jy = view.fy * inv_z;
  for (int k = 0; k < 3; ++k) {
    out.jw[k] = jx * (v[k] - out.x_over_z * v[8 + k]);
    out.jw[3 + k] = jy * (v[4 + k] - out.y_over_z * v[8 + k]);
  }
  const float n2 = g.rotation.x * g.rotation.x + g.rotation.y * g.rotation.y + g.rotation.z * g.rotation.z +
                   g.rotation.w * g.rotation.w;
  out.norm = sqrtf(n2);
  const float inv_norm = 1.0F / out.norm;
  rotation_matrix(
      make_float4(g.rotation.x * inv_norm, g.rotation.y * inv_norm, g.rotation.z * inv_norm, g.rotation.w * inv_norm),
      out.r);
  out.scale = make_float3(__expf(g.log_scale.x), __expf(g.log_scale.y), __expf(g.log_scale.z));
  for (int k = 0; k < 3; ++k) {
    out.m[3 * k] = out.r[3 * k] * out.scale.x;
    out.m[3 * k + 1] = out.r[3 * k + 1] * out.scale.y;
    out.m[3 * k + 2] = out.r[3 * k + 2] * out.scale.z;
  }
  for (int row = 0; row < 2; ++row) {
    for (int k = 0; k < 3; ++k) {
      out.jwm[3 * row + k] =
          out.jw[3 * row] * out.m[k] + out.jw[3 * row + 1] * out.m[3 + k] + out.jw[3 * row + 2] * out.m[6 + k];
    }
  }
  const float a = out.jwm[0] * out.jwm[0] + out.jwm[1] * out.jwm[1] + out.jwm[2] * out.jwm[2];
  out.b = out.jwm[0] * out.jwm[3] + out.jwm[1] * out.jwm[4] + out.jwm[2] * out.jwm[5];
  const float c = out.jwm[3] * out.jwm[3] + out.jwm[4] * out.jwm[4] + out.jwm[5] * out.jwm[5];
  out.a = a + blur;
  out.c = c + blur;
  // A Gram determinant as the squared cross product of its rows: a c - b^2 would cancel for thin Gaussians.
  out.cross =
      make_float3(out.jwm[1] * out.jwm[5] - out.jwm[2] * out.jwm[4], out.jwm[2] * out.jwm[3] - out.jwm[0] * out.jwm[5],
                  out.jwm[0] * out.jwm[4] - out.jwm[1] * out.jwm[3]);
  out.det_sharp = out.cross.x * out.cross.x + out.cross.y * out.cross.y + out.cross.z * out.cross.z;
  out.det = out.det_sharp + blur * (a + out.c);
  constexpr float kBound = 1e15F;
  return out.view.z < kBound && out.det > 0.0F && out.det < 1e30F && out.a < kBound && out.c < kBound &&
         fabsf(tx) * view.fx < kBound && fabsf(ty) * view.fy < kBound;
}

__device__ inline float sigmoid(float x) {
  return 1.0F / (1.0F + __expf(-x));
}

constexpr float kShC0 = 0.28209479177387814F;
constexpr float kShC1 = 0.4886025119029199F;

/// Real SH basis in the order and signs of 3DGS, first kCount of 16 coefficients.
template <int kCount>
__device__ inline void sh_basis(const float3 d, float* y) {
  y[0] = kShC0;
  if constexpr (kCount > 1) {
    y[1] = -kShC1 * d.y;
    y[2] = kShC1 * d.z;
    y[3] = -kShC1 * d.x;
    if constexpr (kCount > 4) {
      const float xx = d.x * d.x, yy = d.y * d.y, zz = d.z * d.z, xy = d.x * d.y, yz = d.y * d.z, xz = d.x * d.z;
      y[4] = 1.0925484305920792F * xy;
      y[5] = -1.0925484305920792F * yz;
      y[6] = 0.31539156525252005F * (2.0F * zz - xx - yy);
      y[7] = -1.0925484305920792F * xz;
      y[8] = 0.5462742152960396F * (xx - yy);
      if constexpr (kCount > 9) {
        y[9] = -0.5900435899266435F * d.y * (3.0F * xx - yy);
        y[10] = 2.890611442640554F * xy * d.z;
        y[11] = -0.4570457994644658F * d.y * (4.0F * zz - xx - yy);
        y[12] = 0.3731763325901154F * d.z * (2.0F * zz - 3.0F * xx - 3.0F * yy);
        y[13] = -0.4570457994644658F * d.x * (4.0F * zz - xx - yy);
        y[14] = 1.445305721320277F * d.z * (xx - yy);
        y[15] = -0.5900435899266435F * d.x * (xx - 3.0F * yy);
      }
    }
  }
}

/// Gradient of sum_k f_k Y_k(d) with respect to d (d taken as free in R^3).
template <int kCount>
__device__ inline float3 sh_direction_gradient(const float3 d, const float* f) {
  float3 g = make_float3(0.0F, 0.0F, 0.0F);
  if constexpr (kCount > 1) {
    g.y -= kShC1 * f[1];
    g.z += kShC1 * f[2];
    g.x -= kShC1 * f[3];
    if constexpr (kCount > 4) {
      constexpr float c20 = 1.0925484305920792F, c22 = 0.31539156525252005F, c24 = 0.5462742152960396F;
      g.x += c20 * d.y * f[4] - 2.0F * c22 * d.x * f[6] - c20 * d.z * f[7] + 2.0F * c24 * d.x * f[8];
      g.y += c20 * d.x * f[4] - c20 * d.z * f[5] - 2.0F * c22 * d.y * f[6] - 2.0F * c24 * d.y * f[8];
      g.z += -c20 * d.y * f[5] + 4.0F * c22 * d.z * f[6] - c20 * d.x * f[7];
      if constexpr (kCount > 9) {
        const float xx = d.x * d.x, yy = d.y * d.y, zz = d.z * d.z, xy = d.x * d.y, yz = d.y * d.z, xz = d.x * d.z;
        constexpr float c30 = -0.5900435899266435F, c31 = 2.890611442640554F, c32 = -0.4570457994644658F,
                        c33 = 0.3731763325901154F, c35 = 1.445305721320277F;
        g.x += c30 * 6.0F * xy * f[9] + c31 * yz * f[10] - c32 * 2.0F * xy * f[11] - c33 * 6.0F * xz * f[12] +
               c32 * (4.0F * zz - 3.0F * xx - yy) * f[13] + c35 * 2.0F * xz * f[14] + c30 * 3.0F * (xx - yy) * f[15];
        g.y += c30 * 3.0F * (xx - yy) * f[9] + c31 * xz * f[10] + c32 * (4.0F * zz - xx - 3.0F * yy) * f[11] -
               c33 * 6.0F * yz * f[12] - c32 * 2.0F * xy * f[13] - c35 * 2.0F * yz * f[14] - c30 * 6.0F * xy * f[15];
        g.z += c31 * xy * f[10] + c32 * 8.0F * yz * f[11] + c33 * (6.0F * zz - 3.0F * xx - 3.0F * yy) * f[12] +
               c32 * 8.0F * xz * f[13] + c35 * (xx - yy) * f[14];
      }
    }
  }
  return g;
}

/// Without normals, only what does not depend on them lights a Gaussian.
__device__ inline float3 load_normal(const Channels<const float>& normals, int i) {
  if (normals.data == nullptr) return make_float3(0.0F, 0.0F, 0.0F);
  const ChannelsOfOne<const float> n = normals.of(i);
  return make_float3(n[0], n[1], n[2]);
}

/// Transfer shading without the residual: colour = albedo * this (model.h).
__device__ inline float3 diffuse_response(const ObjectView& o, const float3 n, float visibility) {
  float y[9];
  sh_basis<9>(n, y);
  const float band[9] = {1.0F, 2.0F / 3.0F, 2.0F / 3.0F, 2.0F / 3.0F, 0.25F, 0.25F, 0.25F, 0.25F, 0.25F};
  float e[3] = {0.0F, 0.0F, 0.0F};
  for (int k = 0; k < 9; ++k) {
    for (int c = 0; c < 3; ++c) e[c] += band[k] * y[k] * o.ambient_sh[3 * k + c];
  }
  const float cosine = fmaxf(0.0F, n.x * o.sun_direction[0] + n.y * o.sun_direction[1] + n.z * o.sun_direction[2]);
  const float direct = visibility * cosine * 0.31830988618379067F;
  return make_float3(e[0] + direct * o.sun_irradiance[0], e[1] + direct * o.sun_irradiance[1],
                     e[2] + direct * o.sun_irradiance[2]);
}

/// Light that residual coefficient k sees: A_k + v S_k.
__device__ inline float3 residual_light(const ObjectView& o, int k, float sun_basis_k, float visibility) {
  const float s = visibility * sun_basis_k * 0.31830988618379067F;
  return make_float3(o.ambient_sh[3 * k] + s * o.sun_irradiance[0], o.ambient_sh[3 * k + 1] + s * o.sun_irradiance[1],
                     o.ambient_sh[3 * k + 2] + s * o.sun_irradiance[2]);
}

}  // namespace splatbus::raster::cuda

#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>

// Arithmetic of what is computed for each pixel, sample and Gaussian, written once and compiled for the host and for
// the device: both do the same operations in the same order. Where they are compiled without fused multiply-adds
// (splatbus_single_source() does that), they agree to the bit wherever they sum in the same order.
#ifdef __CUDACC__
#define SPLATBUS_PORTABLE __host__ __device__ inline
#define SPLATBUS_PORTABLE_MEMBER __host__ __device__
#else
#define SPLATBUS_PORTABLE inline
#define SPLATBUS_PORTABLE_MEMBER
#endif

namespace splatbus::math {

struct Vec3 {
  float x = 0, y = 0, z = 0;
};

SPLATBUS_PORTABLE Vec3 operator+(const Vec3& a, const Vec3& b) {
  return {a.x + b.x, a.y + b.y, a.z + b.z};
}
SPLATBUS_PORTABLE Vec3 operator-(const Vec3& a, const Vec3& b) {
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}
SPLATBUS_PORTABLE Vec3 operator*(const Vec3& a, float s) {
  return {a.x * s, a.y * s, a.z * s};
}
SPLATBUS_PORTABLE float dot(const Vec3& a, const Vec3& b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}
SPLATBUS_PORTABLE Vec3 cross(const Vec3& a, const Vec3& b) {
  return {a.y * b.z - b.y * a.z, a.z * b.x - b.z * a.x, a.x * b.y - b.x * a.y};
}
SPLATBUS_PORTABLE float length(const Vec3& a) {
  return sqrtf(dot(a, a));
}
SPLATBUS_PORTABLE Vec3 normalized(const Vec3& a) {
  return a * (1.0F / sqrtf(dot(a, a)));
}

/// Columns.
struct Mat3 {
  Vec3 x, y, z;
};

SPLATBUS_PORTABLE Vec3 operator*(const Mat3& m, const Vec3& v) {
  return m.x * v.x + m.y * v.y + m.z * v.z;
}
SPLATBUS_PORTABLE Mat3 transposed(const Mat3& m) {
  return {{m.x.x, m.y.x, m.z.x}, {m.x.y, m.y.y, m.z.y}, {m.x.z, m.y.z, m.z.z}};
}

/// a_from_b: p_a = rotation * p_b + translation.
struct Rigid {
  Mat3 rotation;
  Vec3 translation;
};

SPLATBUS_PORTABLE Vec3 transformed(const Rigid& a_from_b, const Vec3& point_b) {
  return a_from_b.rotation * point_b + a_from_b.translation;
}

/// a_from_b of two frames whose units of length differ: p_a = rotation * (scale * p_b) + translation.
struct Similarity {
  Mat3 rotation;
  Vec3 translation;
  float scale = 1;
};

SPLATBUS_PORTABLE Vec3 transformed(const Similarity& a_from_b, const Vec3& point_b) {
  return a_from_b.rotation * (point_b * a_from_b.scale) + a_from_b.translation;
}
SPLATBUS_PORTABLE Similarity operator*(const Similarity& a_from_b, const Similarity& b_from_c) {
  const Mat3 &a = a_from_b.rotation, &b = b_from_c.rotation;
  return {{a * b.x, a * b.y, a * b.z}, transformed(a_from_b, b_from_c.translation), a_from_b.scale * b_from_c.scale};
}
SPLATBUS_PORTABLE Similarity inverse(const Similarity& a_from_b) {
  const Mat3 b_from_a = transposed(a_from_b.rotation);
  return {b_from_a, b_from_a * a_from_b.translation * (-1.0F / a_from_b.scale), 1.0F / a_from_b.scale};
}

/// Of a unit quaternion.
SPLATBUS_PORTABLE Mat3 rotation_matrix(float w, float x, float y, float z) {
  return {{1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)},
          {2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)},
          {2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)}};
}

/// The second, when the first is no number.
SPLATBUS_PORTABLE float larger(float a, float b) {
  return a > b ? a : b;
}
SPLATBUS_PORTABLE float smaller(float a, float b) {
  return a < b ? a : b;
}
SPLATBUS_PORTABLE float clamped(float value, float low, float high) {
  return smaller(larger(value, low), high);
}

/// False for NaN and infinities.
SPLATBUS_PORTABLE bool is_finite(float value) {
  return fabsf(value) <= 3.402823466e38F;
}

/// Element i of an array [n, 3].
SPLATBUS_PORTABLE Vec3 load3(const float* array, std::size_t i) {
  return {array[3 * i], array[3 * i + 1], array[3 * i + 2]};
}

/// The sRGB transfer function (IEC 61966-2-1); clamps to [0, 1].
SPLATBUS_PORTABLE float srgb_from_linear(float linear) {
  const float x = clamped(linear, 0.0F, 1.0F);
  return x <= 0.0031308F ? 12.92F * x : 1.055F * powf(x, 1 / 2.4F) - 0.055F;
}
SPLATBUS_PORTABLE float linear_from_srgb(float srgb) {
  const float x = clamped(srgb, 0.0F, 1.0F);
  return x <= 0.04045F ? x / 12.92F : powf((x + 0.055F) / 1.055F, 2.4F);
}

struct Vec4 {
  Vec3 xyz;
  float w = 0;
};

/// Element i of an array [n, 4] that is aligned to 16 bytes.
SPLATBUS_PORTABLE Vec4 load4(const float* array, std::size_t i) {
#ifdef __CUDA_ARCH__
  const float4 v = reinterpret_cast<const float4*>(array)[i];
  return {{v.x, v.y, v.z}, v.w};
#else
  return {{array[4 * i], array[4 * i + 1], array[4 * i + 2]}, array[4 * i + 3]};
#endif
}

}  // namespace splatbus::math

#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>

// What is computed for each pixel and sample is written once, and compiled for the host and for the device: both do the
// same operations in the same order, without fused multiply-adds, so that they agree to the bit wherever they sum in
// the same order.
#ifdef __CUDACC__
#define SPLATBUS_PORTABLE __host__ __device__ inline
#else
#define SPLATBUS_PORTABLE inline
#endif

namespace splatbus::capture_bridge {

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

/// p_a = rotation * p_b + translation.
struct Motion {
  Mat3 rotation;
  Vec3 translation;
};

SPLATBUS_PORTABLE Vec3 transformed(const Motion& a_from_b, const Vec3& point_b) {
  return a_from_b.rotation * point_b + a_from_b.translation;
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

}  // namespace splatbus::capture_bridge

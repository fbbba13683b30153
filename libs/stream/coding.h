#pragma once

#include <cmath>
#include <cstdint>

#include "math/portable.h"

// The coding space of single values (stream/layout.h), the same bits on the host and on the device: plain IEEE
// operations, never contracted (both sides are compiled so), and elementary functions whose results are those of double
// precision, rounded.
namespace splatbus::stream::coding {

/// Between an attribute's floats and its coding space.
enum class Kind : std::uint8_t { Plain, Opacity, Albedo, Visibility, Rotation, Normal };

// The C library's float functions compute in double; the device's do not.
#ifdef __CUDA_ARCH__
__device__ inline float exponential(float x) {
  return static_cast<float>(exp(static_cast<double>(x)));
}
__device__ inline float power(float x, float y) {
  return static_cast<float>(pow(static_cast<double>(x), static_cast<double>(y)));
}
__device__ inline float sine(float x) {
  return static_cast<float>(sin(static_cast<double>(x)));
}
__device__ inline float cosine(float x) {
  return static_cast<float>(cos(static_cast<double>(x)));
}
#else
SPLATBUS_PORTABLE float exponential(float x) {
  return std::exp(x);
}
SPLATBUS_PORTABLE float power(float x, float y) {
  return std::pow(x, y);
}
SPLATBUS_PORTABLE float sine(float x) {
  return std::sin(x);
}
SPLATBUS_PORTABLE float cosine(float x) {
  return std::cos(x);
}
#endif

/// Angle of the point (x, y) with y >= 0, in [0, pi]; within 3 units in the last place. (Moshier, Cephes, atanf.)
SPLATBUS_PORTABLE float upper_angle(float y, float x) {
  constexpr float kHalfPi = 1.57079633F, kQuarterPi = 0.785398163F;
  const float magnitude = std::abs(x);
  const float numerator = y > magnitude ? magnitude : y, denominator = y > magnitude ? y : magnitude;
  if (denominator == 0.0F) return 0.0F;
  float t = numerator / denominator;  // in [0, 1]
  const bool upper = t > 0.414213562F;
  if (upper) t = (t - 1.0F) / (t + 1.0F);
  const float t2 = t * t;
  const float series =
      (((8.05374449538e-2F * t2 - 1.38776856032e-1F) * t2 + 1.99777106478e-1F) * t2 - 3.33329491539e-1F) * t2 * t + t;
  float angle = upper ? series + kQuarterPi : series;
  if (y > magnitude) angle = kHalfPi - angle;
  return x < 0.0F ? 2.0F * kHalfPi - angle : angle;
}

SPLATBUS_PORTABLE float sigmoid(float logit) {
  return 1.0F / (1.0F + exponential(-logit));
}

/// Of an opacity that is kept off 0 and 1, where it is not finite.
SPLATBUS_PORTABLE float logit(float opacity) {
  const float bounded = opacity < 0.0005F ? 0.0005F : (opacity > 0.9995F ? 0.9995F : opacity);
  return std::log(bounded / (1.0F - bounded));
}

/// The sRGB curve, odd, going on above 1.
SPLATBUS_PORTABLE float srgb_odd(float linear) {
  const float x = std::abs(linear);
  const float y = x <= 0.0031308F ? 12.92F * x : 1.055F * power(x, 1.0F / 2.4F) - 0.055F;
  return std::copysign(y, linear);
}

SPLATBUS_PORTABLE float linear_odd(float encoded) {
  const float x = std::abs(encoded);
  const float y = x <= 0.04045F ? x / 12.92F : power((x + 0.055F) / 1.055F, 2.4F);
  return std::copysign(y, encoded);
}

/// Nearest integer to (value - offset) / step within bounds, which also keep the conversion defined. NaN gives the
/// minimum, half goes away from zero.
struct Step {
  float offset, per_step, minimum, maximum;

  SPLATBUS_PORTABLE_MEMBER std::int32_t operator()(float value) const {
    const float q = (value - offset) * per_step;
    const float capped = q < maximum ? q : maximum;
    const float bounded = q >= minimum ? capped : minimum;
    return static_cast<std::int32_t>(bounded + std::copysign(0.5F, bounded));
  }
};

struct Octahedral {
  float x, y;
};

SPLATBUS_PORTABLE float sign_not_zero(float x) {
  return x < 0.0F ? -1.0F : 1.0F;
}

SPLATBUS_PORTABLE Octahedral octahedral(float x, float y, float z) {
  const float sum = std::abs(x) + std::abs(y) + std::abs(z);
  if (sum < 1e-12F) return {0.0F, 0.0F};
  const Octahedral p{x / sum, y / sum};
  if (z >= 0.0F) return p;
  return {(1.0F - std::abs(p.y)) * sign_not_zero(p.x), (1.0F - std::abs(p.x)) * sign_not_zero(p.y)};
}

struct Vector {
  float x, y, z;
};

/// Of length 1; up the z axis where there is no direction.
SPLATBUS_PORTABLE Vector from_octahedral(const Octahedral& e) {
  Vector n{e.x, e.y, 1.0F - std::abs(e.x) - std::abs(e.y)};
  if (n.z < 0.0F) {
    n = {(1.0F - std::abs(e.y)) * sign_not_zero(e.x), (1.0F - std::abs(e.x)) * sign_not_zero(e.y), n.z};
  }
  const float length = std::sqrt(n.x * n.x + n.y * n.y + n.z * n.z);
  if (!(length > 0.0F)) return {0.0F, 0.0F, 1.0F};
  return {n.x / length, n.y / length, n.z / length};
}

struct Quaternion {
  float w = 1.0F, x = 0.0F, y = 0.0F, z = 0.0F;
};

SPLATBUS_PORTABLE float dot(const Quaternion& a, const Quaternion& b) {
  return a.w * b.w + a.x * b.x + a.y * b.y + a.z * b.z;
}

/// Of length 1; the identity where there is no direction.
SPLATBUS_PORTABLE Quaternion normalized(const Quaternion& q) {
  const float length = std::sqrt(dot(q, q));
  if (!(length > 1e-12F && length <= 3.4028234e38F)) return {};
  return {q.w / length, q.x / length, q.y / length, q.z / length};
}

SPLATBUS_PORTABLE Quaternion from_rotation_vector(const Vector& v) {
  const float angle = std::sqrt(v.x * v.x + v.y * v.y + v.z * v.z);
  if (angle < 1e-6F) return {1.0F, v.x / 2.0F, v.y / 2.0F, v.z / 2.0F};
  const float scale = sine(angle / 2.0F) / angle;
  return {cosine(angle / 2.0F), v.x * scale, v.y * scale, v.z * scale};
}

/// Angle in [0, 2 pi]: a quaternion with w < 0 is the long way round.
SPLATBUS_PORTABLE Vector to_rotation_vector(const Quaternion& q) {
  const float length = std::sqrt(q.x * q.x + q.y * q.y + q.z * q.z);
  const float scale = length < 1e-7F ? 2.0F : 2.0F * upper_angle(length, q.w) / length;
  return {q.x * scale, q.y * scale, q.z * scale};
}

/// R S S R^T is the same for q times half a turn about an axis of the Gaussian, and for -q: that of them which is
/// nearest to `held`.
SPLATBUS_PORTABLE Quaternion nearest_equivalent(const Quaternion& q, const Quaternion& held) {
  const Quaternion candidates[4] = {q, {-q.x, q.w, q.z, -q.y}, {-q.y, -q.z, q.w, q.x}, {-q.z, q.y, -q.x, q.w}};
  Quaternion best = candidates[0];
  float best_dot = dot(best, held);
  for (int k = 1; k < 4; ++k) {
    const float candidate_dot = dot(candidates[k], held);
    if (std::abs(candidate_dot) > std::abs(best_dot)) {
      best = candidates[k];
      best_dot = candidate_dot;
    }
  }
  return best_dot < 0.0F ? Quaternion{-best.w, -best.x, -best.y, -best.z} : best;
}

/// The second largest of three log-scales: a flat Gaussian's extent. Not finite when one of them is not.
SPLATBUS_PORTABLE float middle_of(float a, float b, float c) {
  const float sum = a + b + c;
  if (!(std::abs(sum) <= 3.4028234e38F)) return sum;
  const float low = a < b ? a : b, high = a < b ? b : a;
  const float capped = c < high ? c : high;
  return low > capped ? low : capped;
}

}  // namespace splatbus::stream::coding

#pragma once

#include "capture-bridge/culling_math.h"

namespace splatbus::capture_bridge {

enum class PixelFault : std::uint8_t { None, NotFinite, BadNormal, OffRay };

/// What one pixel says by itself.
struct SurfacePixel {
  PixelFault fault = PixelFault::None;
  float depth_m = 0;  ///< along the camera's z; 0: no surface, or a fault
  float cosine = 0;   ///< between normal and direction to the camera
  std::uint32_t object_id = 0;
};

SPLATBUS_PORTABLE SurfacePixel check_pixel(const PixelView& view, std::uint32_t x, std::uint32_t y) {
  constexpr float kNormalLengthTolerance = 0.05F;
  constexpr float kPixelTolerance = 1.0F;      // engines may jitter the sample position within a pixel
  constexpr float kObjectIds = 4294967296.0F;  // 2^32; ids themselves are exact up to 2^24
  const std::size_t i = static_cast<std::size_t>(y) * view.width + x;
  SurfacePixel pixel;
  const Vec4 position = load4(view.position, i);
  if (position.w == 0) return pixel;
  const Vec3 normal = load4(view.normal, i).xyz;
  const bool finite = is_finite(position.xyz.x) && is_finite(position.xyz.y) && is_finite(position.xyz.z) &&
                      is_finite(normal.x) && is_finite(normal.y) && is_finite(normal.z);
  if (!finite || !(position.w > 0 && position.w < kObjectIds)) {
    pixel.fault = PixelFault::NotFinite;
    return pixel;
  }
  const Vec3 local = view.camera_from_world * (position.xyz - view.centre);
  const float u = view.fx * local.x / local.z + view.cx - (static_cast<float>(x) + 0.5F);
  const float v = view.fy * local.y / local.z + view.cy - (static_cast<float>(y) + 0.5F);
  const bool on_ray = fabsf(u) <= kPixelTolerance && fabsf(v) <= kPixelTolerance;
  if (!on_ray || !(local.z >= 0.5F * view.near_m) || !(local.z <= 1.01F * view.far_m)) {
    pixel.fault = PixelFault::OffRay;
    return pixel;
  }
  const float normal_length = length(normal);
  if (!(fabsf(normal_length - 1) <= kNormalLengthTolerance)) {
    pixel.fault = PixelFault::BadNormal;
    return pixel;
  }
  pixel.depth_m = local.z;
  pixel.object_id = static_cast<std::uint32_t>(position.w);
  pixel.cosine = dot(normal, normalized(view.centre - position.xyz)) / normal_length;
  return pixel;
}

/// What a pixel stands for on the surface.
struct Footprint {
  float metres = 0;   ///< square root of the area; 0: no valid sample
  bool edge = false;  ///< beside a discontinuity
};

/// Arrays of one view's checked pixels.
struct CheckedPixels {
  const float* depth_m = nullptr;
  const std::uint32_t* object_id = nullptr;
};

class FootprintMeasure {
 public:
  SPLATBUS_PORTABLE FootprintMeasure(const PixelView& view, const CheckedPixels& checked)
      : view_(view), checked_(checked) {}

  /// `normal` is the pixel's, of unit length.
  [[nodiscard]] SPLATBUS_PORTABLE Footprint measure(std::uint32_t x, std::uint32_t y, const Vec3& normal) const {
    const std::size_t i = static_cast<std::size_t>(y) * view_.width + x;
    const Vec3 ray = view_.world_from_camera * Vec3{(static_cast<float>(x) + 0.5F - view_.cx) / view_.fx,
                                                    (static_cast<float>(y) + 0.5F - view_.cy) / view_.fy, 1};
    const float facing = dot(normal, ray);
    Footprint footprint;
    const Vec3 along_x =
        step(i, x, view_.width, 1, plane_step(view_.world_from_camera.x * (1.0F / view_.fx), ray, normal, facing, i),
             footprint.edge);
    const Vec3 along_y =
        step(i, y, view_.height, view_.width,
             plane_step(view_.world_from_camera.y * (1.0F / view_.fy), ray, normal, facing, i), footprint.edge);
    footprint.metres = sqrtf(length(cross(along_x, along_y)));
    if (!(footprint.metres > 0) || !is_finite(footprint.metres)) footprint.metres = 0;
    return footprint;
  }

 private:
  static constexpr float kStepRatio = 2.0F;  // longer than this times the tangent plane's step: a discontinuity

  /// From this pixel's point to the next one's, both on its tangent plane: the derivative of the ray's intersection.
  [[nodiscard]] SPLATBUS_PORTABLE Vec3 plane_step(const Vec3& ray_step, const Vec3& ray, const Vec3& normal,
                                                  float facing, std::size_t i) const {
    return (ray_step - ray * (dot(normal, ray_step) / facing)) * checked_.depth_m[i];
  }

  /// False where the neighbour is not of the same surface.
  SPLATBUS_PORTABLE bool neighbour_step(std::size_t i, std::size_t neighbour, const Vec3& expected, Vec3& step) const {
    if (checked_.depth_m[neighbour] == 0 || checked_.object_id[neighbour] != checked_.object_id[i]) return false;
    step = load4(view_.position, neighbour).xyz - load4(view_.position, i).xyz;
    return !(length(step) > kStepRatio * length(expected));
  }

  /// Mean step towards growing coordinates along one axis.
  SPLATBUS_PORTABLE Vec3 step(std::size_t i, std::uint32_t coordinate, std::uint32_t size, std::size_t stride,
                              const Vec3& expected, bool& edge) const {
    Vec3 sum;
    Vec3 step;
    int steps = 0;
    if (coordinate > 0) {
      const bool same = neighbour_step(i, i - stride, expected, step);
      if (same) sum = sum - step;
      steps += same ? 1 : 0;
      edge = edge || !same;
    }
    if (coordinate + 1 < size) {
      const bool same = neighbour_step(i, i + stride, expected, step);
      if (same) sum = sum + step;
      steps += same ? 1 : 0;
      edge = edge || !same;
    }
    return steps == 0 ? expected : sum * (1.0F / static_cast<float>(steps));
  }

  const PixelView& view_;
  const CheckedPixels& checked_;
};

/// Of a pixel that has passed check_pixel, like those beside it.
SPLATBUS_PORTABLE Texel measured_texel(const PixelView& view, const CheckedPixels& checked, std::uint32_t x,
                                       std::uint32_t y) {
  const std::size_t i = static_cast<std::size_t>(y) * view.width + x;
  Texel texel;
  texel.position = load4(view.position, i).xyz;
  texel.normal = normalized(load4(view.normal, i).xyz);
  texel.object_id = checked.object_id[i];
  const Footprint footprint = FootprintMeasure(view, checked).measure(x, y, texel.normal);
  texel.footprint_m = footprint.edge ? -footprint.metres : footprint.metres;
  return texel;
}

}  // namespace splatbus::capture_bridge

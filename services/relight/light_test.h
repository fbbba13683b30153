#pragma once

#include <cstdint>
#include <cstring>

#include "gaussians/light.h"
#include "math/portable.h"
#include "relight/filter.h"

// What one light gives one surface: the arithmetic of visibility.cu, on either device.
namespace splatbus::relight {

constexpr float kMaxSlope = 8.0F;     // metres of depth a metre across: beyond it the normal is no guide
constexpr float kMinFacing = 0.02F;   // cosine below which no light arrives
constexpr float kMaxDeviation_m = 1;  // of a Gaussian
// A paraboloid has the spread of a uniform disc that is smaller by this.
constexpr float kParaboloidOverDisc = 1.2247449F;

/// A Gaussian's surface, in world space.
struct Surface {
  math::Vec3 point, normal;
  float radius_m = 0;  ///< of the filter
};

/// A depth map.
struct MapView {
  math::Rigid camera_from_world;
  float fx, fy, cx, cy;
  float texel;  ///< metres; of a pinhole's, at a depth of 1 m
  int width, height;
  const float* depth_m;
};

struct LightView {
  LightKind kind;
  bool casts_shadow;
  math::Vec3 position, axis;
  float range2_m2, cos_outer;
  const MapView* maps;
  std::uint32_t map_count;
};

/// e^x for x up to 80, within a part of 1e-5; 0 below -80, and for what is no number.
SPLATBUS_PORTABLE float quick_exp(float x) {
  const float bits = math::clamped(x, -80.0F, 80.0F) * 1.4426950F;
  const auto whole = static_cast<std::int32_t>(bits + (bits < 0 ? -0.5F : 0.5F));
  const float part = (bits - static_cast<float>(whole)) * 0.69314718F;  // within ln 2 / 2 of 0
  const float mantissa = 1 + part * (1 + part * (0.5F + part * (1.0F / 6 + part * (1.0F / 24 + part * (1.0F / 120)))));
  const std::uint32_t power = static_cast<std::uint32_t>(whole + 127) << 23U;
  float scale = 0;
  std::memcpy(&scale, &power, sizeof(scale));
  return x > -80.0F ? mantissa * scale : 0.0F;
}

SPLATBUS_PORTABLE float filtered(Projection projection, const MapView& map, const FilterWindow& window) {
  if (!math::is_finite(window.plane + window.x + window.y + window.slope_x + window.slope_y)) return 0;
  const bool apart = window.x + window.radius_x < 0 || window.y + window.radius_y < 0 ||
                     window.x - window.radius_x > static_cast<float>(map.width) ||
                     window.y - window.radius_y > static_cast<float>(map.height);
  if (apart) return 1;
#ifdef __CUDA_ARCH__
  return lit_share(projection, window, map.depth_m, map.width, map.height);
#else
  return lit_share_on_host(projection, window, map.depth_m, map.width, map.height);
#endif
}

SPLATBUS_PORTABLE bool has_all_of(const MapView& map, const FilterWindow& window) {
  return window.x - window.radius_x >= 0 && window.x + window.radius_x <= static_cast<float>(map.width) &&
         window.y - window.radius_y >= 0 && window.y + window.radius_y <= static_cast<float>(map.height);
}

/// Depth of the surface's plane, metres a metre across, bounded.
struct Slope {
  float x, y;
};
SPLATBUS_PORTABLE Slope bounded_slope(float x, float y) {
  const float steepness = sqrtf(x * x + y * y);
  const float factor = steepness > kMaxSlope ? kMaxSlope / steepness : 1.0F;
  return {factor * x, factor * y};
}

SPLATBUS_PORTABLE float bounded_radius(float texels) {
  return math::clamped(texels, kMinRadius_texels, kMaxRadius_texels);
}

SPLATBUS_PORTABLE float share_by_cascades(const LightView& light, const Surface& surface, float lift_texels) {
  for (std::uint32_t k = 0; k < light.map_count; ++k) {
    const MapView& map = light.maps[k];
    const math::Vec3 normal = map.camera_from_world.rotation * surface.normal;
    const float facing = -normal.z;
    if (!(facing > kMinFacing)) return 0;
    const math::Vec3 point =
        transformed(map.camera_from_world, surface.point + surface.normal * (lift_texels * map.texel));
    const Slope slope = bounded_slope(normal.x / facing, normal.y / facing);
    const FilterWindow window{map.fx * point.x + map.cx,
                              map.fy * point.y + map.cy,
                              point.z,
                              slope.x / map.fx,
                              slope.y / map.fy,
                              bounded_radius(surface.radius_m * map.fx),
                              bounded_radius(surface.radius_m * map.fy)};
    if (k + 1 == light.map_count || has_all_of(map, window)) return filtered(Projection::Orthographic, map, window);
  }
  return 1;
}

/// 1 / depth of the plane through `point` is linear over a pinhole's texels: (n . ray) / (n . point), rays with z = 1.
SPLATBUS_PORTABLE float share_by_pinhole(const MapView& map, const Surface& surface, float depth_m, float lift_texels) {
  const float lift_m = lift_texels * map.texel * depth_m;
  const math::Vec3 normal = map.camera_from_world.rotation * surface.normal;
  const math::Vec3 point = transformed(map.camera_from_world, surface.point + surface.normal * lift_m);
  const float along = dot(normal, point);
  if (!(point.z > 0) || !(along < 0)) return 0;
  const float per_depth = 1.0F / point.z;
  const Slope slope = bounded_slope(-point.z * normal.x / along, -point.z * normal.y / along);
  const FilterWindow window{map.fx * point.x * per_depth + map.cx,
                            map.fy * point.y * per_depth + map.cy,
                            per_depth,
                            -slope.x * per_depth / map.fx,
                            -slope.y * per_depth / map.fy,
                            bounded_radius(surface.radius_m * map.fx * per_depth),
                            bounded_radius(surface.radius_m * map.fy * per_depth)};
  return filtered(Projection::Pinhole, map, window);
}

/// Of a point or a spot light.
SPLATBUS_PORTABLE float share_by_faces(const LightView& light, const Surface& surface, float lift_texels) {
  const math::Vec3 way = light.position - surface.point;
  const float distance2 = dot(way, way);
  if (!(distance2 < light.range2_m2)) return 0;
  const float distance = sqrtf(distance2);
  if (!(dot(way, surface.normal) > kMinFacing * distance)) return 0;
  if (light.kind == LightKind::Spot && !(-dot(way, light.axis) > light.cos_outer * distance)) return 0;
  const MapView* face = nullptr;
  float depth_m = 0;
  for (std::uint32_t k = 0; k < light.map_count; ++k) {
    const math::Rigid& of = light.maps[k].camera_from_world;
    const float z = dot({of.rotation.x.z, of.rotation.y.z, of.rotation.z.z}, surface.point) + of.translation.z;
    if (z > depth_m) {
      depth_m = z;
      face = light.maps + k;
    }
  }
  return face != nullptr ? share_by_pinhole(*face, surface, depth_m, lift_texels) : 1.0F;
}

/// What `surface` sees of the light, 255 for all of it.
SPLATBUS_PORTABLE std::uint8_t seen_share(const LightView& light, const Surface& surface, float lift_texels) {
  if (!light.casts_shadow) return 255;
  const float share = light.kind == LightKind::Directional ? share_by_cascades(light, surface, lift_texels)
                                                           : share_by_faces(light, surface, lift_texels);
  return static_cast<std::uint8_t>(share * 255.0F + 0.5F);
}

}  // namespace splatbus::relight

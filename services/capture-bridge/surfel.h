#pragma once

#include <cstdint>

#include "math/portable.h"

// What is done for each pixel of an input view by itself, written once for the host and the device.
namespace splatbus::capture_bridge {

using math::clamped, math::cross, math::dot, math::is_finite, math::larger, math::length, math::load3, math::load4,
    math::Mat3, math::normalized, math::smaller, math::transformed, math::transposed, math::Vec3, math::Vec4;

/// An object that stands elsewhere in the round's frame than in a view's, or of which there are no samples.
struct MovedObject {
  std::uint32_t id = 0;
  bool gone = false;  ///< it has no place in one of the frames, or is not modelled: what the view shows is no sample
  math::Similarity round_from_view, view_from_round;
};

/// An input view as the per-pixel functions read it. The pointers are of one kind of memory, and owned elsewhere.
struct PixelView {
  std::uint32_t width = 0, height = 0;
  float fx = 0, fy = 0, cx = 0, cy = 0;
  float near_m = 0, far_m = 0;
  Vec3 centre;             ///< the camera's, in the world
  Mat3 world_from_camera;  ///< rotation alone
  Mat3 camera_from_world;  ///< rotation alone
  Vec3 background;
  std::uint8_t background_rgb8[3] = {};      ///< as pictures show it
  const float* position = nullptr;           ///< [h, w, 4], as in InputView
  const float* normal = nullptr;             ///< [h, w, 4]
  const std::uint32_t* object_id = nullptr;  ///< [h, w]
  const std::uint8_t* color = nullptr;
  const std::uint8_t* albedo = nullptr;
  const MovedObject* moved = nullptr;  ///< by ascending id
  std::uint32_t moved_count = 0;
  bool far_field = false;  ///< what shows no surface is a sample of the far field
};

/// Null unless the object has moved.
SPLATBUS_PORTABLE const MovedObject* find_moved(const PixelView& view, std::uint32_t object_id) {
  std::uint32_t low = 0;
  std::uint32_t high = view.moved_count;
  while (low < high) {
    const std::uint32_t middle = (low + high) / 2;
    view.moved[middle].id < object_id ? low = middle + 1 : high = middle;
  }
  return low < view.moved_count && view.moved[low].id == object_id ? view.moved + low : nullptr;
}

/// What a pixel shows of a surface, in half a cache line: lookups across cameras jump about.
struct alignas(16) Surfel {
  Vec3 position;          ///< world, in the view's frame
  float footprint_m = 0;  ///< square root of the surface's area that the pixel stands for; 0: no valid sample
  Vec3 normal;            ///< unit
  std::uint32_t object_id = 0;
};

enum class PixelFault : std::uint8_t { None, NotFinite, BadNormal, OffRay };

/// What one pixel says by itself.
struct SurfacePixel {
  PixelFault fault = PixelFault::None;
  float depth_m = 0;  ///< along the camera's z; 0: no surface, or a fault
  float cosine = 0;   ///< between normal and direction to the camera
};

SPLATBUS_PORTABLE SurfacePixel check_pixel(const PixelView& view, std::uint32_t x, std::uint32_t y) {
  constexpr float kNormalLengthTolerance = 0.05F;
  constexpr float kPixelTolerance = 1.0F;  // engines may jitter the sample position within a pixel
  const std::size_t i = static_cast<std::size_t>(y) * view.width + x;
  SurfacePixel pixel;
  if (view.object_id[i] == 0) return pixel;
  const Vec3 position = load4(view.position, i).xyz;
  const Vec3 normal = load4(view.normal, i).xyz;
  const bool finite = is_finite(position.x) && is_finite(position.y) && is_finite(position.z) && is_finite(normal.x) &&
                      is_finite(normal.y) && is_finite(normal.z);
  if (!finite) {
    pixel.fault = PixelFault::NotFinite;
    return pixel;
  }
  const Vec3 local = view.camera_from_world * (position - view.centre);
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
  pixel.cosine = dot(normal, normalized(view.centre - position)) / normal_length;
  return pixel;
}

/// Measures what pixels of a view stand for on the surface: the square root of the area, from the steps to the
/// neighbours' positions. A step that leaves the surface (another object, or longer than twice what the tangent plane
/// says) is replaced by the tangent plane's.
class FootprintMeasure {
 public:
  /// `depth_m` of the view's pixels as check_pixel says.
  SPLATBUS_PORTABLE_MEMBER FootprintMeasure(const PixelView& view, const float* depth_m)
      : view_(view), depth_m_(depth_m) {}

  /// Metres, 0 when there is no sense in it; `normal` is the pixel's, of unit length. Sets `edge` beside a
  /// discontinuity.
  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER float measure(std::uint32_t x, std::uint32_t y, const Vec3& normal,
                                                       bool& edge) const {
    const std::size_t i = static_cast<std::size_t>(y) * view_.width + x;
    const Vec3 ray = view_.world_from_camera * Vec3{(static_cast<float>(x) + 0.5F - view_.cx) / view_.fx,
                                                    (static_cast<float>(y) + 0.5F - view_.cy) / view_.fy, 1};
    const float facing = dot(normal, ray);
    edge = false;
    const Vec3 along_x = step(i, x, view_.width, 1,
                              plane_step(view_.world_from_camera.x * (1.0F / view_.fx), ray, normal, facing, i), edge);
    const Vec3 along_y = step(i, y, view_.height, view_.width,
                              plane_step(view_.world_from_camera.y * (1.0F / view_.fy), ray, normal, facing, i), edge);
    const float metres = sqrtf(length(cross(along_x, along_y)));
    return metres > 0 && is_finite(metres) ? metres : 0;
  }

 private:
  static constexpr float kStepRatio = 2.0F;  // longer than this times the tangent plane's step: a discontinuity

  /// From this pixel's point to the next one's, both on its tangent plane: the derivative of the ray's intersection.
  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER Vec3 plane_step(const Vec3& ray_step, const Vec3& ray, const Vec3& normal,
                                                         float facing, std::size_t i) const {
    return (ray_step - ray * (dot(normal, ray_step) / facing)) * depth_m_[i];
  }

  /// False where the neighbour is not of the same surface.
  SPLATBUS_PORTABLE_MEMBER bool neighbour_step(std::size_t i, std::size_t neighbour, const Vec3& expected,
                                               Vec3& step) const {
    if (depth_m_[neighbour] == 0 || view_.object_id[neighbour] != view_.object_id[i]) return false;
    step = load4(view_.position, neighbour).xyz - load4(view_.position, i).xyz;
    return !(length(step) > kStepRatio * length(expected));
  }

  /// Mean step towards growing coordinates along one axis.
  SPLATBUS_PORTABLE_MEMBER Vec3 step(std::size_t i, std::uint32_t coordinate, std::uint32_t size, std::size_t stride,
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
  const float* depth_m_;
};

/// Of a pixel that has passed check_pixel, as `depth_m` says of the view's pixels.
SPLATBUS_PORTABLE Surfel measured_surfel(const PixelView& view, const float* depth_m, std::uint32_t x, std::uint32_t y,
                                         bool& edge) {
  const std::size_t i = static_cast<std::size_t>(y) * view.width + x;
  Surfel surfel;
  surfel.position = load4(view.position, i).xyz;
  surfel.normal = normalized(load4(view.normal, i).xyz);
  surfel.object_id = view.object_id[i];
  surfel.footprint_m = FootprintMeasure(view, depth_m).measure(x, y, surfel.normal, edge);
  return surfel;
}

/// The sphere that samples of the far field lie on.
struct FarField {
  std::uint32_t frame_id = 0;
  Vec3 centre;
  float radius = 0;
};

/// Of a byte, that is more than the background's rounding.
constexpr int kLeastDifference = 2;
/// Pixels a side of which one is a sample of the far field.
constexpr std::uint32_t kFarFieldStep = 3;

/// A sample of the far field, where the pixel shows something there besides the background; else none.
SPLATBUS_PORTABLE Surfel far_surfel(const PixelView& view, const FarField& far, std::uint32_t x, std::uint32_t y) {
  Surfel surfel;
  const std::size_t i = static_cast<std::size_t>(y) * view.width + x;
  if (!view.far_field || view.object_id[i] != 0 || view.color[4 * i + 3] != 0) return surfel;
  if (x % kFarFieldStep != 0 || y % kFarFieldStep != 0) return surfel;
  bool shows = false;
  for (int c = 0; c < 3; ++c) {
    const int above = static_cast<int>(view.color[4 * i + static_cast<std::size_t>(c)]) - view.background_rgb8[c];
    shows = shows || above > kLeastDifference || above < -kLeastDifference;
  }
  if (!shows) return surfel;
  const Vec3 ray{(static_cast<float>(x) + 0.5F - view.cx) / view.fx, (static_cast<float>(y) + 0.5F - view.cy) / view.fy,
                 1};
  const float cosine = 1 / length(ray);  // to the camera's axis
  const Vec3 direction = view.world_from_camera * (ray * cosine);
  surfel.position = far.centre + direction * far.radius;
  surfel.normal = direction * -1.0F;
  surfel.object_id = far.frame_id;
  // A pixel's solid angle is cosine^3 / (fx fy).
  surfel.footprint_m =
      static_cast<float>(kFarFieldStep) * far.radius * sqrtf(cosine * cosine * cosine / (view.fx * view.fy));
  return surfel;
}

}  // namespace splatbus::capture_bridge

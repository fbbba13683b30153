#include "capture-bridge/surface.h"

#include <fmt/format.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <cmath>
#include <mutex>
#include <optional>

namespace splatbus::capture_bridge {

namespace {

constexpr float kNormalLengthTolerance = 0.05F;
constexpr float kPixelTolerance = 1.0F;  // engines may jitter the sample position within a pixel
constexpr float kStepRatio = 2.0F;       // longer than this times the tangent plane's step: a discontinuity

bool finite(const glm::vec4& v) {
  return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z) && std::isfinite(v.w);
}

bool finite3(const glm::vec4& v) {
  return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z);
}

class SurfaceAnalysis {
 public:
  SurfaceAnalysis(const InputView& view, const SurfaceOptions& options, ViewSurface& surface)
      : view_(view),
        options_(options),
        surface_(surface),
        camera_from_world_(inverse(view.camera.world_from_camera)),
        axes_(view.camera.world_from_camera.rotation) {}

  /// Validity, depth and cosine of one pixel.
  void check(std::size_t x, std::size_t y, DropCounts& dropped) {
    const std::size_t i = index(x, y);
    const glm::vec4& position = view_.position[i];
    const glm::vec4& normal = view_.normal[i];
    if (position.w == 0) return;
    // 2^32 as a float; ids themselves are exact up to 2^24.
    if (!finite(position) || !finite3(normal) || position.w < 0 || position.w >= 4294967296.0F) {
      ++dropped.not_finite;
      return;
    }
    const Camera& camera = view_.camera;
    const glm::vec3 local = camera_from_world_ * glm::vec3(position);
    const float u = camera.fx * local.x / local.z + camera.cx - (static_cast<float>(x) + 0.5F);
    const float v = camera.fy * local.y / local.z + camera.cy - (static_cast<float>(y) + 0.5F);
    const bool on_ray = std::abs(u) <= kPixelTolerance && std::abs(v) <= kPixelTolerance;
    if (!on_ray || !(local.z >= 0.5F * camera.near_m) || !(local.z <= 1.01F * camera.far_m)) {
      ++dropped.off_ray;
      return;
    }
    const float length = glm::length(glm::vec3(normal));
    if (std::abs(length - 1) > kNormalLengthTolerance) {
      ++dropped.bad_normal;
      return;
    }
    surface_.depth_m[i] = local.z;
    surface_.object_id[i] = static_cast<std::uint32_t>(position.w);
    const glm::vec3 to_camera = glm::normalize(camera.world_from_camera.translation - glm::vec3(position));
    surface_.cosine[i] = glm::dot(glm::vec3(normal), to_camera) / length;
    if (surface_.cosine[i] < options_.min_cosine) ++dropped.grazing;
  }

  /// Footprint and edge of one pixel; needs check() of its neighbours.
  void measure(std::size_t x, std::size_t y) {
    const std::size_t i = index(x, y);
    if (surface_.depth_m[i] == 0 || surface_.cosine[i] < options_.min_cosine) return;
    const glm::vec3 normal = glm::normalize(glm::vec3(view_.normal[i]));
    const Camera& camera = view_.camera;
    const glm::vec3 ray = axes_ * glm::vec3((static_cast<float>(x) + 0.5F - camera.cx) / camera.fx,
                                            (static_cast<float>(y) + 0.5F - camera.cy) / camera.fy, 1);
    const float facing = glm::dot(normal, ray);
    bool edge = false;
    const glm::vec3 along_x =
        step(i, x, view_.camera.width, 1, plane_step(axes_[0] / camera.fx, ray, normal, facing, i), edge);
    const glm::vec3 along_y = step(i, y, view_.camera.height, view_.camera.width,
                                   plane_step(axes_[1] / camera.fy, ray, normal, facing, i), edge);
    surface_.footprint_m[i] = std::sqrt(glm::length(glm::cross(along_x, along_y)));
    surface_.edge[i] = edge ? 1 : 0;
    if (!(surface_.footprint_m[i] > 0) || !std::isfinite(surface_.footprint_m[i])) surface_.footprint_m[i] = 0;
  }

 private:
  [[nodiscard]] std::size_t index(std::size_t x, std::size_t y) const { return y * view_.camera.width + x; }

  /// From this pixel's point to the next one's, both on its tangent plane: the derivative of the ray's intersection.
  [[nodiscard]] glm::vec3 plane_step(const glm::vec3& ray_step, const glm::vec3& ray, const glm::vec3& normal,
                                     float facing, std::size_t i) const {
    return surface_.depth_m[i] * (ray_step - ray * (glm::dot(normal, ray_step) / facing));
  }

  [[nodiscard]] std::optional<glm::vec3> neighbour_step(std::size_t i, std::size_t neighbour,
                                                        const glm::vec3& expected) const {
    if (surface_.depth_m[neighbour] == 0 || surface_.object_id[neighbour] != surface_.object_id[i]) return std::nullopt;
    const glm::vec3 step = glm::vec3(view_.position[neighbour]) - glm::vec3(view_.position[i]);
    if (glm::length(step) > kStepRatio * glm::length(expected)) return std::nullopt;
    return step;
  }

  /// Mean step towards growing coordinates along one axis.
  [[nodiscard]] glm::vec3 step(std::size_t i, std::size_t coordinate, std::size_t size, std::size_t stride,
                               const glm::vec3& expected, bool& edge) const {
    glm::vec3 sum(0);
    int steps = 0;
    if (coordinate > 0) {
      const auto back = neighbour_step(i, i - stride, expected);
      back ? (sum -= *back, ++steps) : edge = true;
    }
    if (coordinate + 1 < size) {
      const auto ahead = neighbour_step(i, i + stride, expected);
      ahead ? (sum += *ahead, ++steps) : edge = true;
    }
    return steps == 0 ? expected : sum / static_cast<float>(steps);
  }

  const InputView& view_;
  const SurfaceOptions& options_;
  ViewSurface& surface_;
  Rigid camera_from_world_;
  glm::mat3 axes_;  // the camera's axes in the world
};

}  // namespace

DropCounts& DropCounts::operator+=(const DropCounts& other) {
  not_finite += other.not_finite;
  bad_normal += other.bad_normal;
  off_ray += other.off_ray;
  grazing += other.grazing;
  return *this;
}

std::string DropCounts::text() const {
  return fmt::format("{} not finite, {} with a normal that is not unit, {} that do not project to their pixel",
                     not_finite, bad_normal, off_ray);
}

ViewSurface analyse_surface(const InputView& view, const SurfaceOptions& options) {
  const std::size_t width = view.camera.width;
  const std::size_t pixels = view.pixels();
  ViewSurface surface;
  surface.footprint_m.assign(pixels, 0);
  surface.cosine.assign(pixels, 0);
  surface.depth_m.assign(pixels, 0);
  surface.object_id.assign(pixels, 0);
  surface.edge.assign(pixels, 0);
  SurfaceAnalysis analysis(view, options, surface);
  std::mutex mutex;
  const tbb::blocked_range<std::size_t> rows(0, view.camera.height, 16);
  tbb::parallel_for(rows, [&](const tbb::blocked_range<std::size_t>& range) {
    DropCounts dropped;
    for (std::size_t y = range.begin(); y < range.end(); ++y) {
      for (std::size_t x = 0; x < width; ++x) analysis.check(x, y, dropped);
    }
    const std::scoped_lock lock(mutex);
    surface.dropped += dropped;
  });
  tbb::parallel_for(rows, [&](const tbb::blocked_range<std::size_t>& range) {
    for (std::size_t y = range.begin(); y < range.end(); ++y) {
      for (std::size_t x = 0; x < width; ++x) analysis.measure(x, y);
    }
  });
  return surface;
}

}  // namespace splatbus::capture_bridge

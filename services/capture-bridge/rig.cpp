#include "capture-bridge/rig.h"

#include <algorithm>
#include <cmath>
#include <glm/gtc/constants.hpp>
#include <sstream>

namespace splatbus::capture_bridge {

namespace {

// Cameras at or below the horizon would stand inside the ground, and one straight above has no defined heading.
constexpr float kLowestSine = 0.08F;
constexpr float kHighestSine = 0.98F;

constexpr float kLargestTangent = 3.7320508F;  // of half of 150 degrees
constexpr int kSmallestSide = 8;               // pixels

Camera with_id(Camera camera, std::size_t id, CameraRole role) {
  camera.id = static_cast<std::uint32_t>(id);
  camera.role = role;
  return camera;
}

Camera framed(const glm::vec3& eye, const glm::vec3& target, const PictureSize& size, float fov_radians) {
  return look_at(eye, target, static_cast<std::uint32_t>(size.width), static_cast<std::uint32_t>(size.height),
                 fov_radians);
}

/// What the viewer's picture shows and a margin about it, in about as many square pixels as `size` has.
Camera picture_of(const Camera& viewer, const PictureSize& size, float margin) {
  const auto tangent = [margin](std::uint32_t pixels, float centre, float focal) {
    constexpr float kSmallestTangent = 0.004F;
    return std::clamp(margin * std::max(centre, static_cast<float>(pixels) - centre) / focal, kSmallestTangent,
                      kLargestTangent);
  };
  const float x = tangent(viewer.width, viewer.cx, viewer.fx), y = tangent(viewer.height, viewer.cy, viewer.fy);
  const float focal = std::sqrt(static_cast<float>(size.pixels()) / (4 * x * y));
  const auto side = [&](float half) { return std::max(kSmallestSide, static_cast<int>(std::ceil(2 * half * focal))); };
  const PictureSize shape(side(x), side(y));
  return framed({0, 0, 0}, {0, 0, 1}, shape, 2 * std::atan(0.5F * static_cast<float>(shape.height) / focal));
}

}  // namespace

std::vector<Camera> dome_cameras(const DomeOptions& options, const glm::vec3& centre, float heading_radians) {
  const float golden_angle = glm::pi<float>() * (3 - std::sqrt(5.0F));
  std::vector<Camera> cameras;
  cameras.reserve(static_cast<std::size_t>(options.cameras));
  for (int i = 0; i < options.cameras; ++i) {
    const float t = (static_cast<float>(i) + 0.5F) / static_cast<float>(options.cameras);
    const float sine = kLowestSine + (kHighestSine - kLowestSine) * t;
    const float flat = std::sqrt(1 - sine * sine);
    // Minus the heading: angles about y turn -z towards -x, while (cos, sin) on (x, z) turns the other way.
    const float angle = golden_angle * static_cast<float>(i) - heading_radians;
    const glm::vec3 direction(flat * std::cos(angle), sine, flat * std::sin(angle));
    cameras.push_back(with_id(framed(centre + options.radius_m * direction, centre, options.size, options.fov_radians),
                              cameras.size(), CameraRole::Input));
  }
  return cameras;
}

std::vector<Camera> ring_cameras(const RingOptions& options) {
  std::vector<Camera> cameras;
  cameras.reserve(static_cast<std::size_t>(options.cameras));
  for (int i = 0; i < options.cameras; ++i) {
    const float angle =
        options.phase_radians + glm::two_pi<float>() * static_cast<float>(i) / static_cast<float>(options.cameras);
    const glm::vec3 eye(options.target.x + options.radius_m * std::cos(angle), options.height_m,
                        options.target.z + options.radius_m * std::sin(angle));
    cameras.push_back(
        with_id(framed(eye, options.target, options.size, options.fov_radians), cameras.size(), CameraRole::Reference));
  }
  return cameras;
}

std::vector<Camera> follow_cameras(const FollowOptions& options, const Camera& viewer) {
  const Camera pinhole = options.viewers_picture ? picture_of(viewer, options.size, options.margin)
                                                 : framed({0, 0, 0}, {0, 0, 1}, options.size, options.fov_radians);
  std::vector<Camera> cameras;
  cameras.reserve(static_cast<std::size_t>(options.cameras));
  for (int i = 0; i < options.cameras; ++i) {
    const int place_ring = (i + 2) / 3;  // 0 | 1 1 1 | 2 2 2 | ...
    const auto ring = static_cast<float>(place_ring);
    glm::vec3 offset(0);  // in the viewer's frame: x right, y down
    glm::quat turn(1, 0, 0, 0);
    if (i > 0) {
      const int place = (i - 1) % 3;
      const float toe_in = options.toe_in_radians * ring;
      if (place == 2) {
        offset.y = -options.above_m * ring;
        turn = glm::angleAxis(-toe_in, glm::vec3(1, 0, 0));
      } else {
        const float side = place == 0 ? -1.0F : 1.0F;
        offset.x = side * options.side_m * ring;
        turn = glm::angleAxis(-side * toe_in, glm::vec3(0, 1, 0));
      }
    }
    Camera camera = pinhole;
    camera.world_from_camera = viewer.world_from_camera * Rigid{.rotation = turn, .translation = offset};
    cameras.push_back(with_id(camera, cameras.size(), CameraRole::Reference));
  }
  return cameras;
}

bool parse_size(const std::string& text, int minimum, int maximum, PictureSize& size) {
  std::istringstream in(text);
  int width = 0;
  char by = 0;
  if (!(in >> width)) return false;
  int height = width;
  if (!(in >> std::ws).eof() && (!(in >> by >> height) || by != 'x' || !(in >> std::ws).eof())) return false;
  if (std::min(width, height) < minimum || std::max(width, height) > maximum) return false;
  size = {width, height};
  return true;
}

bool parse_point(const std::string& text, glm::vec3& point) {
  std::istringstream in(text);
  glm::vec3 parsed;
  char comma1 = 0;
  char comma2 = 0;
  if (!(in >> parsed.x >> comma1 >> parsed.y >> comma2 >> parsed.z) || comma1 != ',' || comma2 != ',') return false;
  if (!(in >> std::ws).eof()) return false;
  point = parsed;
  return true;
}

}  // namespace splatbus::capture_bridge

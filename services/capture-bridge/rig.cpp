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

float wrapped(float angle) {
  return std::remainder(angle, glm::two_pi<float>());
}

Camera with_id(Camera camera, std::size_t id, CameraRole role) {
  camera.id = static_cast<std::uint32_t>(id);
  camera.role = role;
  return camera;
}

}  // namespace

ViewerState ViewerState::of(const Camera& camera) {
  return {.position = camera.world_from_camera.translation,
          .forward = camera.world_from_camera.rotation * glm::vec3(0, 0, 1)};
}

float ViewerState::heading(float fallback) const {
  const glm::vec2 flat(forward.x, forward.z);
  if (glm::length(flat) < 0.05F) return fallback;
  return std::atan2(-flat.x, -flat.y);
}

std::vector<Camera> dome_cameras(const DomeOptions& options, const glm::vec3& centre, float heading_radians) {
  const float golden_angle = glm::pi<float>() * (3 - std::sqrt(5.0F));
  const auto size = static_cast<std::uint32_t>(options.size);
  std::vector<Camera> cameras;
  cameras.reserve(static_cast<std::size_t>(options.cameras));
  for (int i = 0; i < options.cameras; ++i) {
    const float t = (static_cast<float>(i) + 0.5F) / static_cast<float>(options.cameras);
    const float sine = kLowestSine + (kHighestSine - kLowestSine) * t;
    const float flat = std::sqrt(1 - sine * sine);
    // Minus the heading: angles about y turn -z towards -x, while (cos, sin) on (x, z) turns the other way.
    const float angle = golden_angle * static_cast<float>(i) - heading_radians;
    const glm::vec3 direction(flat * std::cos(angle), sine, flat * std::sin(angle));
    cameras.push_back(with_id(look_at(centre + options.radius_m * direction, centre, size, size, options.fov_radians),
                              cameras.size(), CameraRole::Input));
  }
  return cameras;
}

std::vector<Camera> ring_cameras(const RingOptions& options) {
  const auto size = static_cast<std::uint32_t>(options.size);
  std::vector<Camera> cameras;
  cameras.reserve(static_cast<std::size_t>(options.cameras));
  for (int i = 0; i < options.cameras; ++i) {
    const float angle =
        options.phase_radians + glm::two_pi<float>() * static_cast<float>(i) / static_cast<float>(options.cameras);
    const glm::vec3 eye(options.target.x + options.radius_m * std::cos(angle), options.height_m,
                        options.target.z + options.radius_m * std::sin(angle));
    cameras.push_back(
        with_id(look_at(eye, options.target, size, size, options.fov_radians), cameras.size(), CameraRole::Reference));
  }
  return cameras;
}

std::vector<Camera> follow_cameras(const FollowOptions& options, const Camera& viewer) {
  const auto size = static_cast<std::uint32_t>(options.size);
  const Camera pinhole = look_at({0, 0, 0}, {0, 0, 1}, size, size, options.fov_radians);
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

bool InputRigTracker::update(const Options& options, const ViewerState* viewer, const ContentHeights& content) {
  Pose wanted{.centre = options.centre, .heading_radians = pose_.heading_radians};
  if (viewer != nullptr) {
    wanted.heading_radians = viewer->heading(pose_.heading_radians);
    if (!options.fixed_centre) {
      wanted.centre = viewer->position + options.focus_m * viewer->forward;
      wanted.centre.y = std::clamp(wanted.centre.y, content.low_m, std::max(content.low_m, content.high_m));
    }
  }
  const bool moved = glm::distance(wanted.centre, pose_.centre) > options.move_m ||
                     std::abs(wrapped(wanted.heading_radians - pose_.heading_radians)) > options.turn_radians;
  if (placed_ && !moved) return false;
  placed_ = true;
  pose_ = wanted;
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

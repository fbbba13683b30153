#include "capture-bridge/dome.h"

#include <algorithm>
#include <cmath>
#include <glm/gtc/constants.hpp>

namespace splatbus::capture_bridge {

DomePlace dome_place(const DomePlacement& options, const Viewer* viewer, const FreeSpace* free, float heading_before) {
  if (viewer == nullptr) return {.centre = options.centre, .heading_radians = heading_before};
  DomePlace place{.centre = options.centre, .heading_radians = viewer->heading(heading_before)};
  if (options.fixed_centre) return place;
  glm::vec3 from = viewer->position() + options.lead_s * viewer->velocity_m_s;
  glm::vec3 ahead = viewer->forward();
  if (free != nullptr) {
    from = free->reachable(from, 0);
    // Nothing is to be seen in the sky.
    if (std::isinf(free->distance(ahead))) ahead.y = std::min(ahead.y, 0.0F);
  }
  place.centre = from + options.focus_m * ahead;
  if (free == nullptr) return place;
  const float metres = glm::distance(place.centre, free->place());
  if (metres > 0) {
    const glm::vec3 way = (place.centre - free->place()) / metres;
    place.centre = free->place() + std::min(metres, free->distance(way)) * way;
  }
  return place;
}

namespace {

constexpr float kEyeMargin = 1.15F;  // of the tangents of half a picture's angles

/// Of places ever higher over the dome's centre the first that can be seen, else the one that was wished, drawn back.
glm::vec3 free_place(const glm::vec3& wished, const glm::vec3& centre, const FreeSpace& free, float clearance_m) {
  const float radius_m = glm::distance(wished, centre);
  const glm::vec3 direction = (wished - centre) / radius_m;
  for (const float lift : {0.0F, 0.3F, 0.6F}) {
    const glm::vec3 place = centre + radius_m * glm::normalize(glm::mix(direction, glm::vec3(0, 1, 0), lift));
    if (free.reachable(place, clearance_m) == place) return lift == 0 ? wished : place;
  }
  return free.reachable(wished, clearance_m);
}

}  // namespace

std::vector<Camera> free_dome(const DomeOptions& options, const DomePlace& place, const FreeSpace* free,
                              float clearance_m) {
  std::vector<Camera> cameras = dome_cameras(options, place.centre, place.heading_radians);
  if (free == nullptr) return cameras;
  for (Camera& camera : cameras) {
    const glm::vec3 wished = camera.world_from_camera.translation;
    const glm::vec3 eye = free_place(wished, place.centre, *free, clearance_m);
    if (eye == wished) continue;
    const bool near = glm::distance(eye, place.centre) < 0.5F * options.radius_m;
    camera.world_from_camera = look_at(eye, near ? free->place() : place.centre, 1, 1, 1).world_from_camera;
  }
  return cameras;
}

Camera eye_camera(const DomeOptions& options, const DomePlacement& placement, const Viewer& viewer,
                  const FreeSpace* free, float clearance_m) {
  DomeOptions one = options;
  one.cameras = 1;
  Camera camera = dome_cameras(one, {0, 0, 0}, 0).front();
  const Camera& picture = viewer.camera;
  const auto focal = [](std::uint32_t pixels, std::uint32_t own, float centre, float its_focal) {
    const float half = std::max(centre, static_cast<float>(pixels) - centre);
    return 0.5F * static_cast<float>(own) * its_focal / (kEyeMargin * half);
  };
  camera.fx = camera.fy = std::min({camera.fx, focal(picture.width, camera.width, picture.cx, picture.fx),
                                    focal(picture.height, camera.height, picture.cy, picture.fy)});
  camera.world_from_camera = viewer.pose_in(placement.lead_s);
  glm::vec3& eye = camera.world_from_camera.translation;
  eye = free != nullptr ? free->reachable(eye, clearance_m) : viewer.position();
  return camera;
}

std::vector<Camera> cameras_about(const Camera& eye, const FreeSpace* free, std::size_t count) {
  constexpr float kWidest = 1.9198622F;  // 110 degrees
  if (count == 0) return {};
  const glm::vec3 gaze = eye.world_from_camera.rotation * glm::vec3(0, 0, 1);
  const float heading = std::atan2(gaze.z, gaze.x);
  // Of the level the eye sees this much to either side, or nothing where it looks up or down.
  const bool sees_level = std::abs(gaze.y) < std::sin(std::atan(0.5F * static_cast<float>(eye.height) / eye.fy));
  const float seen = sees_level ? std::atan(0.5F * static_cast<float>(eye.width) / eye.fx) : 0;
  const float step = (glm::two_pi<float>() - 2 * seen) / static_cast<float>(count);
  const auto level = [](float angle) { return glm::vec3(std::cos(angle), 0, std::sin(angle)); };
  const auto shows = [&](float angle) { return free == nullptr || !std::isinf(free->distance(level(angle))); };
  Camera camera = eye;
  camera.fx = camera.fy =
      0.5F * static_cast<float>(camera.width) / (kEyeMargin * std::tan(0.5F * std::min(step, kWidest)));
  std::vector<Camera> cameras;
  for (std::size_t k = 0; k < count; ++k) {
    const float angle = heading + seen + step * (static_cast<float>(k) + 0.5F);
    if (!shows(angle) && !shows(angle + step / 3) && !shows(angle - step / 3)) continue;
    const glm::vec3& place = eye.world_from_camera.translation;
    camera.world_from_camera = look_at(place, place + level(angle), 1, 1, 1).world_from_camera;
    cameras.push_back(camera);
  }
  return cameras;
}

}  // namespace splatbus::capture_bridge

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

std::vector<Camera> eye_cameras(const DomeOptions& options, const DomePlacement& placement, const Viewer& viewer,
                                const FreeSpace* free, float clearance_m, std::size_t about) {
  constexpr float kMargin = 1.15F;        // of the tangents of half a picture's angles
  constexpr float kWidest = 1.9198622F;   // of a picture that looks about: 110 degrees
  DomeOptions one = options;
  one.cameras = 1;
  Camera camera = dome_cameras(one, {0, 0, 0}, 0).front();
  const Camera& picture = viewer.camera;
  const auto focal = [](std::uint32_t pixels, std::uint32_t own, float centre, float its_focal) {
    const float half = std::max(centre, static_cast<float>(pixels) - centre);
    return 0.5F * static_cast<float>(own) * its_focal / (kMargin * half);
  };
  camera.fx = camera.fy = std::min({camera.fx, focal(picture.width, camera.width, picture.cx, picture.fx),
                                    focal(picture.height, camera.height, picture.cy, picture.fy)});
  camera.world_from_camera = viewer.pose_in(placement.lead_s);
  glm::vec3& eye = camera.world_from_camera.translation;
  eye = free != nullptr ? free->reachable(eye, clearance_m) : viewer.position();
  std::vector<Camera> cameras{camera};
  const float step = glm::two_pi<float>() / static_cast<float>(about + 1);
  camera.fx = camera.fy =
      0.5F * static_cast<float>(camera.width) / (kMargin * std::tan(0.5F * std::min(step, kWidest)));
  const glm::vec3 gaze = camera.world_from_camera.rotation * glm::vec3(0, 0, 1);
  const float heading = std::atan2(gaze.z, gaze.x);
  for (std::size_t k = 1; k <= about; ++k) {
    const float angle = heading + step * static_cast<float>(k);
    const glm::vec3 direction(std::cos(angle), 0, std::sin(angle));
    camera.world_from_camera = look_at(eye, eye + direction, 1, 1, 1).world_from_camera;
    cameras.push_back(camera);
  }
  return cameras;
}

}  // namespace splatbus::capture_bridge

#include "capture-bridge/culling.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>

namespace splatbus::capture_bridge {

namespace {

constexpr float kPlaneTolerance = 0.5F;    // pixel extents off the tangent plane
constexpr float kLateralTolerance = 1.5F;  // pixel extents on it: a pixel's centre is at most 0.71 from any point in it

/// One view, ready for many projections.
struct Projector {
  Projector(const InputView& view_in, const ViewSurface& surface_in, const ObjectTransforms& round_objects)
      : view(&view_in),
        surface(&surface_in),
        centre(view_in.camera.world_from_camera.translation),
        camera_from_world(glm::transpose(glm::mat3_cast(view_in.camera.world_from_camera.rotation))),
        to_round(round_from_view(view_in.objects, round_objects)) {}

  const InputView* view;
  const ViewSurface* surface;
  glm::vec3 centre;
  glm::mat3 camera_from_world;
  ObjectTransforms to_round;
};

/// A camera that sees the point.
struct Candidate {
  std::uint32_t camera = 0;
  float quality = 0;  // metres, smaller is better
  float footprint_m = 0;
};

struct SurfacePoint {
  glm::vec3 position, normal;  // in the frame of the view it came from
  std::uint32_t object_id;
};

class Culling {
 public:
  Culling(Views views, std::span<const ViewSurface> surfaces, const CullOptions& options) : options_(options) {
    for (std::size_t i = 0; i < views.size(); ++i) {
      projectors_.emplace_back(*views[i], surfaces[i], views.front()->objects);
      movement_ = movement_ || !projectors_.back().to_round.empty();
    }
  }

  /// Density that remains at pixel `i` of camera `own`, 0 when its sample goes.
  [[nodiscard]] float kept_density(std::uint32_t own, std::size_t i, std::vector<Candidate>& seen_by) const {
    const Projector& here = projectors_[own];
    const ViewSurface& surface = *here.surface;
    if (surface.footprint_m[i] == 0) return 0;
    const SurfacePoint point{.position = glm::vec3(here.view->position[i]),
                             .normal = glm::normalize(glm::vec3(here.view->normal[i])),
                             .object_id = surface.object_id[i]};
    seen_by.clear();
    for (std::uint32_t other = 0; other < projectors_.size(); ++other) {
      if (other == own) {
        seen_by.push_back(
            {own, quality(here, point, surface.depth_m[i], surface.edge[i] != 0), surface.footprint_m[i]});
      } else {
        consider(other, movement_ ? moved(point, own, other) : point, seen_by);
      }
    }
    return rank(own, seen_by);
  }

 private:
  [[nodiscard]] float quality(const Projector& camera, const SurfacePoint& point, float depth_m, bool edge) const {
    const float cosine = glm::dot(point.normal, glm::normalize(camera.centre - point.position));
    if (cosine <= 0) return std::numeric_limits<float>::infinity();
    return depth_m / (camera.view->camera.fx * cosine) * (edge ? options_.edge_penalty : 1.0F);
  }

  [[nodiscard]] SurfacePoint moved(SurfacePoint point, std::uint32_t from, std::uint32_t to) const {
    const auto apply = [&point](const Rigid& transform) {
      point.position = transform * point.position;
      point.normal = transform.rotation * point.normal;
    };
    const auto& there = projectors_[from].to_round;
    if (const auto found = there.find(point.object_id); found != there.end()) apply(found->second);
    const auto& back = projectors_[to].to_round;
    if (const auto found = back.find(point.object_id); found != back.end()) apply(inverse(found->second));
    return point;
  }

  /// Adds the camera when its own pixel at the point holds a sample of the same surface.
  void consider(std::uint32_t index, const SurfacePoint& point, std::vector<Candidate>& seen_by) const {
    const Projector& other = projectors_[index];
    const Camera& camera = other.view->camera;
    const glm::vec3 local = other.camera_from_world * (point.position - other.centre);
    if (local.z < camera.near_m) return;
    const float x = camera.fx * local.x / local.z + camera.cx;
    const float y = camera.fy * local.y / local.z + camera.cy;
    if (!(x >= 0) || !(y >= 0) || x >= static_cast<float>(camera.width) || y >= static_cast<float>(camera.height))
      return;
    const std::size_t pixel = static_cast<std::size_t>(y) * camera.width + static_cast<std::size_t>(x);
    const ViewSurface& surface = *other.surface;
    if (surface.footprint_m[pixel] == 0 || surface.object_id[pixel] != point.object_id) return;
    if (glm::dot(point.normal, glm::vec3(other.view->normal[pixel])) < options_.min_normal_cosine) return;
    const float extent = quality(other, point, local.z, false);
    const glm::vec3 offset = glm::vec3(other.view->position[pixel]) - point.position;
    if (std::abs(glm::dot(offset, point.normal)) > kPlaneTolerance * extent) return;
    if (glm::length(offset) > kLateralTolerance * extent) return;
    const bool edge = surface.edge[pixel] != 0;
    seen_by.push_back({index, edge ? extent * options_.edge_penalty : extent, surface.footprint_m[pixel]});
  }

  /// The best first: those similar to the best by index, then the others by quality. `own` keeps its sample when it is
  /// among the first cameras_per_surface.
  [[nodiscard]] float rank(std::uint32_t own, std::vector<Candidate>& seen_by) const {
    float best = seen_by.front().quality;
    for (const Candidate& candidate : seen_by) best = std::min(best, candidate.quality);
    const float similar = best * (1 + options_.similar);
    std::sort(seen_by.begin(), seen_by.end(), [similar](const Candidate& a, const Candidate& b) {
      const bool a_similar = a.quality <= similar;
      const bool b_similar = b.quality <= similar;
      if (a_similar != b_similar) return a_similar;
      if (!a_similar && a.quality != b.quality) return a.quality < b.quality;
      return a.camera < b.camera;
    });
    const std::size_t winners =
        std::min<std::size_t>(seen_by.size(), static_cast<std::size_t>(options_.cameras_per_surface));
    float density = 0;
    bool kept = false;
    for (std::size_t i = 0; i < winners; ++i) {
      density += 1 / (seen_by[i].footprint_m * seen_by[i].footprint_m);
      kept = kept || seen_by[i].camera == own;
    }
    return kept ? density : 0;
  }

  CullOptions options_;
  std::vector<Projector> projectors_;
  bool movement_ = false;
};

}  // namespace

KeptDensity cull_across_cameras(Views views, std::span<const ViewSurface> surfaces, const CullOptions& options) {
  KeptDensity density(views.size());
  if (views.empty()) return density;
  const Culling culling(views, surfaces, options);
  for (std::size_t own = 0; own < views.size(); ++own) density[own].resize(views[own]->pixels());
  tbb::parallel_for(std::size_t{0}, views.size(), [&](std::size_t own) {
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, density[own].size(), 2048),
                      [&](const tbb::blocked_range<std::size_t>& range) {
                        std::vector<Candidate> seen_by;
                        seen_by.reserve(views.size());
                        for (std::size_t i = range.begin(); i < range.end(); ++i) {
                          density[own][i] = culling.kept_density(static_cast<std::uint32_t>(own), i, seen_by);
                        }
                      });
  });
  return density;
}

ObjectTransforms round_from_view(const ObjectTransforms& view_objects, const ObjectTransforms& round_objects) {
  ObjectTransforms moved;
  for (const auto& [id, world_from_object] : view_objects) {
    const auto found = round_objects.find(id);
    if (found == round_objects.end()) continue;
    const bool same = found->second.translation == world_from_object.translation &&
                      found->second.rotation == world_from_object.rotation;
    if (!same) moved.emplace(id, found->second * inverse(world_from_object));
  }
  return moved;
}

}  // namespace splatbus::capture_bridge

#include "capture-bridge/culling.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>

namespace splatbus::capture_bridge {

namespace {

constexpr float kPlaneTolerance = 0.5F;    // pixel extents off the tangent plane
constexpr float kLateralTolerance = 1.5F;  // pixel extents on it: a pixel's centre is at most 0.71 from any point in it

/// What culling reads of a pixel, together in half a cache line: the lookups jump about.
struct Texel {
  glm::vec3 position{0};
  float footprint_m = 0;  // 0: no valid sample; negative: beside a discontinuity
  glm::vec3 normal{0};
  std::uint32_t object_id = 0;
};

/// One view, ready for many projections.
struct Projector {
  Projector(const InputView& view, const ViewSurface& surface, const ObjectTransforms& round_objects)
      : camera(view.camera),
        centre(view.camera.world_from_camera.translation),
        camera_from_world(glm::transpose(glm::mat3_cast(view.camera.world_from_camera.rotation))),
        to_round(round_from_view(view.objects, round_objects)),
        texels(view.pixels()) {
    for (std::size_t i = 0; i < texels.size(); ++i) {
      if (surface.footprint_m[i] == 0) continue;
      texels[i] = {.position = glm::vec3(view.position[i]),
                   .footprint_m = surface.edge[i] != 0 ? -surface.footprint_m[i] : surface.footprint_m[i],
                   .normal = glm::normalize(glm::vec3(view.normal[i])),
                   .object_id = surface.object_id[i]};
    }
  }

  Camera camera;
  glm::vec3 centre;
  glm::mat3 camera_from_world;
  ObjectTransforms to_round;
  std::vector<Texel> texels;
};

/// A camera that sees the point.
struct Candidate {
  std::uint32_t camera = 0;
  float quality = 0;  // metres, smaller is better
  float footprint_m = 0;
};

class Culling {
 public:
  Culling(Views views, std::span<const ViewSurface> surfaces, const CullOptions& options) : options_(options) {
    projectors_.reserve(views.size());
    for (std::size_t i = 0; i < views.size(); ++i) {
      projectors_.emplace_back(*views[i], surfaces[i], views.front()->objects);
      movement_ = movement_ || !projectors_.back().to_round.empty();
    }
  }

  /// Density that remains at pixel `i` of camera `own`, 0 when its sample goes.
  [[nodiscard]] float kept_density(std::uint32_t own, std::size_t i, std::vector<Candidate>& seen_by) const {
    const Projector& here = projectors_[own];
    const Texel& point = here.texels[i];
    if (point.footprint_m == 0) return 0;
    const float depth_m = (here.camera_from_world * (point.position - here.centre)).z;
    seen_by.clear();
    for (std::uint32_t other = 0; other < projectors_.size(); ++other) {
      if (other == own) {
        seen_by.push_back({own, extent(here, point, depth_m) * penalty(point), std::abs(point.footprint_m)});
      } else if (movement_) {
        consider(other, moved(point, own, other), seen_by);
      } else {
        consider(other, point, seen_by);
      }
    }
    return options_.cameras_per_surface == 1 ? density_of_best(own, seen_by) : rank(own, seen_by);
  }

 private:
  /// Longest extent of a camera's pixel on the surface, metres.
  [[nodiscard]] static float extent(const Projector& camera, const Texel& point, float depth_m) {
    const glm::vec3 to_camera = camera.centre - point.position;
    const float facing = glm::dot(point.normal, to_camera);
    if (facing <= 0) return std::numeric_limits<float>::infinity();
    return depth_m * glm::length(to_camera) / (camera.camera.fx * facing);
  }

  [[nodiscard]] float penalty(const Texel& texel) const { return texel.footprint_m < 0 ? options_.edge_penalty : 1; }

  [[nodiscard]] Texel moved(Texel point, std::uint32_t from, std::uint32_t to) const {
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
  void consider(std::uint32_t index, const Texel& point, std::vector<Candidate>& seen_by) const {
    const Projector& other = projectors_[index];
    const Camera& camera = other.camera;
    const glm::vec3 local = other.camera_from_world * (point.position - other.centre);
    if (local.z < camera.near_m) return;
    const float x = camera.fx * local.x / local.z + camera.cx;
    const float y = camera.fy * local.y / local.z + camera.cy;
    if (!(x >= 0 && y >= 0 && x < static_cast<float>(camera.width) && y < static_cast<float>(camera.height))) return;
    const Texel& texel = other.texels[static_cast<std::size_t>(y) * camera.width + static_cast<std::size_t>(x)];
    if (texel.footprint_m == 0 || texel.object_id != point.object_id) return;
    if (glm::dot(point.normal, texel.normal) < options_.min_normal_cosine) return;
    const float pixel_m = extent(other, point, local.z);
    const glm::vec3 offset = texel.position - point.position;
    if (std::abs(glm::dot(offset, point.normal)) > kPlaneTolerance * pixel_m) return;
    if (glm::dot(offset, offset) > kLateralTolerance * kLateralTolerance * pixel_m * pixel_m) return;
    seen_by.push_back({index, pixel_m * penalty(texel), std::abs(texel.footprint_m)});
  }

  [[nodiscard]] float similar_to_best(const std::vector<Candidate>& seen_by) const {
    float best = seen_by.front().quality;
    for (const Candidate& candidate : seen_by) best = std::min(best, candidate.quality);
    return best * (1 + options_.similar);
  }

  /// rank() for one camera a surface, without sorting; candidates come in order of their index.
  [[nodiscard]] float density_of_best(std::uint32_t own, const std::vector<Candidate>& seen_by) const {
    const float similar = similar_to_best(seen_by);
    const auto winner = std::find_if(seen_by.begin(), seen_by.end(),
                                     [similar](const Candidate& candidate) { return candidate.quality <= similar; });
    if (winner == seen_by.end() || winner->camera != own) return 0;
    return 1 / (winner->footprint_m * winner->footprint_m);
  }

  /// The best first: those similar to the best by index, then the others by quality. `own` keeps its sample when it is
  /// among the first cameras_per_surface.
  [[nodiscard]] float rank(std::uint32_t own, std::vector<Candidate>& seen_by) const {
    const float similar = similar_to_best(seen_by);
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

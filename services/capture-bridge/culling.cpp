#include "capture-bridge/culling.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cassert>
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

  /// Fills `seen_by` with the cameras that see what pixel `i` of camera `own` sees, and returns own's rank among them;
  /// 0 when there is no valid sample.
  [[nodiscard]] std::size_t rank(std::uint32_t own, std::size_t i, std::vector<Candidate>& seen_by) const {
    const Projector& here = projectors_[own];
    const Texel& point = here.texels[i];
    seen_by.clear();
    if (point.footprint_m == 0) return 0;
    const float depth_m = (here.camera_from_world * (point.position - here.centre)).z;
    const Candidate self{own, extent(here, point, depth_m) * penalty(point)};
    for (std::uint32_t other = 0; other < projectors_.size(); ++other) {
      if (other == own) {
        seen_by.push_back(self);
      } else if (movement_) {
        consider(other, moved(point, own, other), seen_by);
      } else {
        consider(other, point, seen_by);
      }
    }
    return 1 + preceding(self, seen_by);
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
    seen_by.push_back({index, pixel_m * penalty(texel)});
  }

  /// How many come before `self`: first those similar to the best, by index, then the others, by quality.
  [[nodiscard]] std::size_t preceding(const Candidate& self, const std::vector<Candidate>& seen_by) const {
    float best = self.quality;
    for (const Candidate& candidate : seen_by) best = std::min(best, candidate.quality);
    const float similar = best * (1 + options_.similar);
    const auto precedes = [&](const Candidate& candidate) {
      if (self.quality <= similar) return candidate.quality <= similar && candidate.camera < self.camera;
      if (candidate.quality != self.quality) return candidate.quality < self.quality;
      return candidate.camera < self.camera;
    };
    return static_cast<std::size_t>(std::count_if(seen_by.begin(), seen_by.end(), precedes));
  }

  CullOptions options_;
  std::vector<Projector> projectors_;
  bool movement_ = false;
};

}  // namespace

std::vector<SurfaceRanks> rank_across_cameras(Views views, std::span<const ViewSurface> surfaces,
                                              const CullOptions& options) {
  assert(views.size() < 256);
  std::vector<SurfaceRanks> ranks(views.size());
  if (views.empty()) return ranks;
  const Culling culling(views, surfaces, options);
  tbb::parallel_for(std::size_t{0}, views.size(), [&](std::size_t own) {
    SurfaceRanks& out = ranks[own];
    out.rank.resize(views[own]->pixels());
    out.seen_by.resize(views[own]->pixels());
    tbb::parallel_for(
        tbb::blocked_range<std::size_t>(0, out.rank.size(), 2048), [&](const tbb::blocked_range<std::size_t>& range) {
          std::vector<Candidate> seen_by;
          seen_by.reserve(views.size());
          for (std::size_t i = range.begin(); i < range.end(); ++i) {
            out.rank[i] = static_cast<std::uint8_t>(culling.rank(static_cast<std::uint32_t>(own), i, seen_by));
            out.seen_by[i] = static_cast<std::uint8_t>(seen_by.size());
          }
        });
  });
  return ranks;
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

#include "gaussians/pages.h"

#include <algorithm>
#include <optional>
#include <unordered_map>

#include "gaussians/model.h"
#include "gaussians/portable.h"

namespace splatbus {

std::vector<IndexRange> select_ranges(const GaussiansView& gaussians, const FrustumCamera& camera,
                                      const Rigid& world_from_camera, const ObjectTransforms& objects,
                                      const FarthestSurfaces& surfaces) {
  struct Frame {
    math::Rigid camera_from_frame;
    float scale = 1;
    PageFrustum frustum;
  };
  const Rigid camera_from_world = inverse(world_from_camera);
  std::unordered_map<std::uint32_t, std::optional<Frame>> frames;
  const auto frame = [&](std::uint32_t frame_id) -> const std::optional<Frame>& {
    const auto entry = frames.try_emplace(frame_id);
    std::optional<Frame>& known = entry.first->second;
    if (!entry.second) return known;
    const auto see_as = [&](const Rigid& camera_from_frame, float scale) {
      const math::Rigid rigid = portable(camera_from_frame);
      known = Frame{rigid, scale, page_frustum(camera, rigid, scale)};
    };
    if (frame_id == kWorldFrame) {
      see_as(camera_from_world, 1);
    } else if (const auto object = objects.find(frame_id); object != objects.end()) {
      const ObjectTransform seen = seen_from(world_from_camera.translation, frame_id, object->second);
      see_as(camera_from_world * seen.rigid, seen.scale);
    }
    return known;
  };
  std::vector<IndexRange> selected;
  for (std::size_t k = 0; k < gaussians.ranges.size(); ++k) {
    const IndexRange& range = gaussians.ranges[k];
    const auto& of = frame(range.frame_id);
    if (!of || !may_show(of->frustum, gaussians.bounds[k])) continue;
    const bool hidden = range.frame_id != kFarFieldFrame &&
                        is_behind(surfaces, camera, of->camera_from_frame, of->scale, gaussians.bounds[k]);
    if (!hidden) selected.push_back(range);
  }
  return selected;
}

PageBounds bounds_of(const GaussiansView& gaussians, const IndexRange& range) {
  PageBounds bounds;
  for (std::uint32_t i = range.first; i < range.first + range.count; ++i) {
    const auto channel = [&](int c) { return *gaussians.at(c, i); };
    constexpr int kMean = ParameterLayout::kMean, kLogScale = ParameterLayout::kLogScale;
    include(bounds, {channel(kMean), channel(kMean + 1), channel(kMean + 2)},
            std::max({channel(kLogScale), channel(kLogScale + 1), channel(kLogScale + 2)}));
  }
  return bounds;
}

}  // namespace splatbus

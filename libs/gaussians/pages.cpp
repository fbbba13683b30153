#include "gaussians/pages.h"

#include <algorithm>
#include <optional>
#include <unordered_map>

#include "gaussians/model.h"
#include "gaussians/portable.h"

namespace splatbus {

std::vector<IndexRange> select_ranges(const GaussiansView& gaussians, const FrustumCamera& camera,
                                      const Rigid& world_from_camera, const ObjectTransforms& objects) {
  const Rigid camera_from_world = inverse(world_from_camera);
  std::unordered_map<std::uint32_t, std::optional<PageFrustum>> frustum_of;
  const auto frustum = [&](std::uint32_t frame_id) -> const std::optional<PageFrustum>& {
    const auto [entry, is_new] = frustum_of.try_emplace(frame_id);
    if (!is_new) return entry->second;
    if (frame_id == kWorldFrame) {
      entry->second = page_frustum(camera, portable(camera_from_world));
    } else if (const auto object = objects.find(frame_id); object != objects.end()) {
      const ObjectTransform seen = seen_from(world_from_camera.translation, frame_id, object->second);
      entry->second = page_frustum(camera, portable(camera_from_world * seen.rigid), seen.scale);
    }
    return entry->second;
  };
  std::vector<IndexRange> selected;
  for (std::size_t k = 0; k < gaussians.ranges.size(); ++k) {
    const auto& sides = frustum(gaussians.ranges[k].frame_id);
    if (sides && may_show(*sides, gaussians.bounds[k])) selected.push_back(gaussians.ranges[k]);
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

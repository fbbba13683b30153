#include "gateway/foxglove/point_sample.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <span>

#include "gaussians/sh.h"
#include "splats/baked_model.h"

namespace splatbus::gateway::foxglove {

namespace {

std::uint8_t byte_of(float value) {
  return static_cast<std::uint8_t>(std::lround(std::clamp(value, 0.0F, 1.0F) * 255));
}

/// Every `step`-th Gaussian, without pages.
GaussiansBuffer gather(const GaussiansView& from, std::span<const IndexRange> ranges, std::size_t count,
                       std::size_t step) {
  GaussiansBuffer out(from.layout, (count + step - 1) / step);
  std::size_t number = 0, taken = 0;
  const auto copy = [&](const float* source, int channels, std::size_t offset, std::vector<float>& target) {
    for (int c = 0; c < channels && source != nullptr; ++c) {
      target[static_cast<std::size_t>(c) * out.stride() + taken] =
          source[offset + static_cast<std::size_t>(c) * from.stride];
    }
  };
  for (const IndexRange& range : ranges) {
    if (range.frame_id == kFarFieldFrame) continue;
    for (std::size_t i = range.first; i < std::size_t{range.first} + range.count; ++i, ++number) {
      if (number % step != 0) continue;
      const std::size_t offset = from.offset(i);
      copy(from.parameters, from.layout.channels(), offset, out.parameters);
      copy(from.normal, 3, offset, out.normal);
      copy(from.visibility, 1, offset, out.visibility);
      out.object_id[taken] = from.object_id != nullptr ? from.object_id[offset] : range.frame_id;
      ++taken;
    }
  }
  out.resize(taken);
  return out;
}

}  // namespace

std::string sample_points(const GaussiansView& gaussians, const SceneState& scene, std::size_t max_points) {
  const IndexRange all{.count = static_cast<std::uint32_t>(gaussians.count)};
  const std::span<const IndexRange> ranges = gaussians.has_pages() ? gaussians.ranges : std::span(&all, 1);
  std::size_t count = 0;
  for (const IndexRange& range : ranges) count += range.frame_id == kFarFieldFrame ? 0 : range.count;
  std::string points;
  if (count == 0 || max_points == 0) return points;
  const GaussiansBuffer sample = gather(gaussians, ranges, count, (count + max_points - 1) / max_points);
  const splats::BakedModel baked(sample.view(), scene);
  points.reserve(baked.count() * kPointBytes);
  for (std::size_t i = 0; i < baked.count(); ++i) {
    const splats::Splat splat = baked[i];
    const glm::vec3 color = 0.5F + kShC0 * splat.sh[0];
    const std::array<float, 3> place{splat.mean.x, splat.mean.y, splat.mean.z};
    const std::array<std::uint8_t, 4> rgba{byte_of(color.r), byte_of(color.g), byte_of(color.b),
                                           byte_of(1 / (1 + std::exp(-splat.opacity_logit)))};
    points.append(reinterpret_cast<const char*>(place.data()), sizeof place);
    points.append(reinterpret_cast<const char*>(rgba.data()), sizeof rgba);
  }
  return points;
}

}  // namespace splatbus::gateway::foxglove

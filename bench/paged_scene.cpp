#include "bench/paged_scene.h"

#include <algorithm>
#include <cmath>
#include <glm/glm.hpp>
#include <numeric>

namespace splatbus::bench {
namespace {

glm::vec3 mean_of(const GaussiansView& gaussians, std::size_t i) {
  return {gaussians.plane(0)[i], gaussians.plane(1)[i], gaussians.plane(2)[i]};
}

/// Every third bit, from the lowest on.
std::uint64_t spread_bits(std::uint32_t value) {
  std::uint64_t out = 0;
  for (unsigned bit = 0; bit < 21; ++bit) out |= std::uint64_t{value >> bit & 1U} << (3 * bit);
  return out;
}

/// Cells of 1 cm.
std::uint64_t morton_key(const glm::vec3& mean) {
  std::uint64_t key = 0;
  for (int axis = 0; axis < 3; ++axis) {
    const float cell = std::clamp(mean[axis] * 100 + 1048576.0F, 0.0F, 2097151.0F);
    key |= spread_bits(static_cast<std::uint32_t>(cell)) << static_cast<unsigned>(axis);
  }
  return key;
}

/// Distance from `center` within which 19 of 20 Gaussians are.
float extent(const GaussiansView& gaussians, const glm::vec3& center) {
  std::vector<float> distances(gaussians.count);
  for (std::size_t i = 0; i < gaussians.count; ++i) distances[i] = glm::distance(mean_of(gaussians, i), center);
  const auto at = distances.begin() + static_cast<std::ptrdiff_t>(distances.size() * 19 / 20);
  std::nth_element(distances.begin(), at, distances.end());
  return *at;
}

}  // namespace

PagedScene::PagedScene(const GaussiansView& planar) : layout_(planar.layout) {
  constexpr std::uint32_t kFill = kPageLanes * 3 / 4;
  const auto channels = static_cast<std::size_t>(layout_.channels());
  std::vector<std::pair<std::uint64_t, std::uint32_t>> order(planar.count);
  for (std::uint32_t i = 0; i < order.size(); ++i) order[i] = {morton_key(mean_of(planar, i)), i};
  std::sort(order.begin(), order.end());
  page_floats_ = (channels + 4) * kRowWords;
  const std::size_t pages = (order.size() + kFill - 1) / kFill;
  memory_.resize(pages * page_floats_);
  for (std::size_t page = 0; page < pages; ++page) {
    const auto count = static_cast<std::uint32_t>(std::min<std::size_t>(kFill, order.size() - page * kFill));
    for (std::uint32_t lane = 0; lane < count; ++lane) {
      const std::size_t i = order[page * kFill + lane].second;
      float* const to = memory_.data() + page * page_floats_ + lane;
      for (std::size_t c = 0; c < channels; ++c) to[c * kRowWords] = planar.plane(static_cast<int>(c))[i];
      for (std::size_t c = 0; c < 3; ++c) to[(channels + c) * kRowWords] = planar.normal[c * planar.stride + i];
      to[(channels + 3) * kRowWords] = planar.visibility[i];
    }
    ranges_.push_back({static_cast<std::uint32_t>(page) * kPageLanes, count});
  }
  for (const IndexRange& range : ranges_) bounds_.push_back(bounds_of(view(false), range));
}

GaussiansView PagedScene::view(bool with_bounds) const {
  const auto channels = static_cast<std::size_t>(layout_.channels());
  GaussiansView out;
  out.layout = layout_;
  out.count = ranges_.size() * kPageLanes;
  out.stride = kRowWords;
  out.page_shift = kPageShift;
  out.page_stride = page_floats_;
  out.ranges = ranges_;
  if (with_bounds) out.bounds = bounds_;
  out.parameters = memory_.data();
  out.normal = memory_.data() + channels * kRowWords;
  out.visibility = memory_.data() + (channels + 3) * kRowWords;
  return out;
}

GaussiansBuffer stacked(const GaussiansBuffer& scene, const std::vector<Camera>& cameras, int copies) {
  const GaussiansView one = scene.view();
  glm::dvec3 sum(0);
  for (std::size_t i = 0; i < one.count; ++i) sum += mean_of(one, i);
  const glm::vec3 center = sum / std::max(1.0, static_cast<double>(one.count));
  glm::vec3 up(0);
  float furthest = 0;
  for (const Camera& camera : cameras) {
    up -= camera.world_from_camera.rotation * glm::vec3(0, 1, 0);
    furthest = std::max(furthest, glm::distance(camera.world_from_camera.translation, center));
  }
  const glm::vec3 step = glm::normalize(up) * 3.0F * (furthest + extent(one, center));
  GaussiansBuffer out(scene.layout(), one.count * static_cast<std::size_t>(copies));
  for (std::size_t copy = 0; copy < static_cast<std::size_t>(copies); ++copy) {
    const auto copy_planes = [&](const auto& from, auto& to) {
      for (std::size_t c = 0; c < from.size() / scene.stride(); ++c) {
        std::copy_n(from.begin() + static_cast<std::ptrdiff_t>(c * scene.stride()), one.count,
                    to.begin() + static_cast<std::ptrdiff_t>(c * out.stride() + copy * one.count));
      }
    };
    copy_planes(scene.parameters, out.parameters);
    copy_planes(scene.normal, out.normal);
    copy_planes(scene.visibility, out.visibility);
    for (int axis = 0; axis < 3; ++axis) {
      float* const plane = out.parameters.data() + static_cast<std::size_t>(axis) * out.stride() + copy * one.count;
      for (std::size_t i = 0; i < one.count; ++i) plane[i] += static_cast<float>(copy) * step[axis];
    }
  }
  return out;
}

}  // namespace splatbus::bench

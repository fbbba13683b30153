#include "capture-bridge/spacing.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <nanoflann.hpp>

namespace splatbus::capture_bridge {

namespace {

constexpr std::size_t kNeighbours = 4;
constexpr std::size_t kSearched = 9;  // itself and enough to find four on the same side of an edge or a thin sheet
constexpr float kSameSurfaceCosine = 0.5F;
constexpr float kLargestRatio = 4.0F;

struct PointCloud {
  std::span<const glm::vec3> points;
  // nanoflann's names
  [[nodiscard]] std::size_t kdtree_get_point_count() const { return points.size(); }
  [[nodiscard]] float kdtree_get_pt(std::size_t i, std::size_t axis) const { return points[i][static_cast<int>(axis)]; }
  template <class Box>
  bool kdtree_get_bbox(Box& /*box*/) const {
    return false;
  }
};

using Tree =
    nanoflann::KDTreeSingleIndexAdaptor<nanoflann::L2_Simple_Adaptor<float, PointCloud>, PointCloud, 3, std::uint32_t>;

float spacing_of(const Tree& tree, std::span<const glm::vec3> position, std::span<const glm::vec3> normal,
                 std::size_t i, float fallback_m) {
  std::array<std::uint32_t, kSearched> index{};
  std::array<float, kSearched> distance2{};
  nanoflann::KNNResultSet<float, std::uint32_t> found(kSearched);
  found.init(index.data(), distance2.data());
  tree.findNeighbors(found, &position[i].x, nanoflann::SearchParams());
  float sum = 0;
  std::size_t neighbours = 0;
  for (std::size_t k = 0; k < found.size() && neighbours < kNeighbours; ++k) {
    if (index[k] == i || glm::dot(normal[index[k]], normal[i]) < kSameSurfaceCosine) continue;
    sum += std::sqrt(distance2[k]);
    ++neighbours;
  }
  if (neighbours < 2) return fallback_m;
  return std::clamp(sum / static_cast<float>(neighbours), fallback_m / kLargestRatio, fallback_m * kLargestRatio);
}

}  // namespace

std::vector<float> estimate_spacing(std::span<const glm::vec3> position, std::span<const glm::vec3> normal,
                                    std::span<const float> fallback_m) {
  std::vector<float> spacing(position.size());
  if (position.empty()) return spacing;
  const PointCloud cloud{position};
  Tree tree(3, cloud, nanoflann::KDTreeSingleIndexAdaptorParams(10));
  tree.buildIndex();
  tbb::parallel_for(tbb::blocked_range<std::size_t>(0, position.size(), 1024),
                    [&](const tbb::blocked_range<std::size_t>& range) {
                      for (std::size_t i = range.begin(); i < range.end(); ++i) {
                        spacing[i] = spacing_of(tree, position, normal, i, fallback_m[i]);
                      }
                    });
  return spacing;
}

}  // namespace splatbus::capture_bridge

#include "capture-bridge/spacing.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cassert>
#include <cstdint>

#include "capture-bridge/leaf_search.h"

namespace splatbus::capture_bridge {

std::vector<float> estimate_spacing(std::span<const glm::vec3> position, std::span<const glm::vec3> normal,
                                    std::span<const float> fallback_m) {
  assert(normal.size() == position.size() && fallback_m.size() == position.size());
  std::vector<float> spacing(position.size());
  if (position.empty()) return spacing;
  const auto count = static_cast<std::uint32_t>(position.size());
  const std::uint32_t leaves = NeighbourTree::leaves_for(count);
  std::vector<Box> nodes(2 * std::size_t{leaves});
  const NeighbourTree tree{&position[0].x, count, leaves, nodes.data()};
  for (std::uint32_t leaf = 0; leaf < leaves; ++leaf) tree.build_leaf(leaf);
  for (std::uint32_t node = leaves - 1; node > 0; --node) tree.build_node(node);
  const LeafSearch search(tree);
  using Range = tbb::blocked_range<std::uint32_t>;
  tbb::parallel_for(Range(0, (count + LeafSearch::kPoints - 1) / LeafSearch::kPoints, 128), [&](const Range& range) {
    for (std::uint32_t leaf = range.begin(); leaf < range.end(); ++leaf) {
      const LeafSearch::Found nearest = search.nearest(leaf);
      const std::uint32_t first = leaf * LeafSearch::kPoints;
      for (std::uint32_t i = first; i < std::min(first + LeafSearch::kPoints, count); ++i) {
        spacing[i] = spacing_of(nearest[i - first], &normal[0].x, i, fallback_m[i]);
      }
    }
  });
  return spacing;
}

}  // namespace splatbus::capture_bridge

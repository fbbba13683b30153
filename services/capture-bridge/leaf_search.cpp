#include "capture-bridge/leaf_search.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>

namespace splatbus::capture_bridge {

LeafSearch::LeafSearch(const NeighbourTree& tree)
    : tree_(tree), leaves_((std::size_t{tree.count} + kPoints - 1) / kPoints) {
  for (std::uint32_t i = 0; i < tree.count; ++i) {
    const Vec3 point = load3(tree.points, i);
    LeafPoints& leaf = leaves_[i / kPoints];
    leaf.x[i % kPoints] = point.x;
    leaf.y[i % kPoints] = point.y;
    leaf.z[i % kPoints] = point.z;
  }
}

std::uint32_t LeafSearch::points_of(std::uint32_t leaf) const {
  const std::uint32_t first = leaf * kPoints;
  return first >= tree_.count ? 0 : std::min(kPoints, tree_.count - first);
}

/// The search from one leaf.
class LeafSearch::Query {
 public:
  Query(const LeafSearch& search, std::uint32_t leaf)
      : search_(search), leaf_(leaf), points_(search.points_of(leaf)), box_(search.tree_.nodes[node_of(leaf)]) {}

  Found run() {
    // The leaf beside its own bounds the search well before it begins.
    add(leaf_);
    add(leaf_ ^ 1U);
    descend();
    return found_;
  }

 private:
  [[nodiscard]] std::uint32_t node_of(std::uint32_t leaf) const { return search_.tree_.leaves + leaf; }

  /// What is farther from the leaf than this is of no use to any of its points.
  void update_bound() {
    bound2_ = 0;
    for (std::uint32_t q = 0; q < points_; ++q) bound2_ = std::max(bound2_, found_[q].farthest2());
  }

  /// Offers another leaf's points to each of this one's.
  void add(std::uint32_t other) {
    const std::uint32_t count = search_.points_of(other);
    if (count == 0) return;
    const Box& box = search_.tree_.nodes[node_of(other)];
    const LeafPoints& theirs = search_.leaves_[other];
    const LeafPoints& ours = search_.leaves_[leaf_];
    for (std::uint32_t q = 0; q < points_; ++q) {
      const Vec3 point{ours.x[q], ours.y[q], ours.z[q]};
      if (distance2(box, point) > found_[q].farthest2()) continue;
      std::array<float, kPoints> d2;
      for (std::uint32_t p = 0; p < kPoints; ++p) {
        const Vec3 offset = Vec3{theirs.x[p], theirs.y[p], theirs.z[p]} - point;
        d2[p] = dot(offset, offset);
      }
      for (std::uint32_t p = 0; p < count; ++p) found_[q].add(d2[p], other * kPoints + p);
    }
    update_bound();
  }

  void descend() {
    const Box* const nodes = search_.tree_.nodes;
    const std::uint32_t leaves = search_.tree_.leaves;
    std::array<std::uint32_t, 32> waiting;  // the tree's depth is below that
    std::array<float, 32> waiting2;
    std::size_t depth = 1;
    waiting[0] = 1;
    waiting2[0] = 0;
    while (depth > 0) {
      --depth;
      if (waiting2[depth] > bound2_) continue;
      std::uint32_t node = waiting[depth];
      while (node < leaves) {
        const std::size_t left = 2 * std::size_t{node};
        const float left2 = distance2(nodes[left], box_);
        const float right2 = distance2(nodes[left + 1], box_);
        const std::uint32_t near = left2 <= right2 ? 0 : 1;
        const float far2 = std::max(left2, right2);
        if (far2 <= bound2_ && far2 < INFINITY) {
          waiting[depth] = 2 * node + 1 - near;
          waiting2[depth++] = far2;
        }
        if (std::min(left2, right2) > bound2_) break;
        node = 2 * node + near;
      }
      if (node >= leaves && ((node - leaves) ^ leaf_) > 1) add(node - leaves);
    }
  }

  const LeafSearch& search_;
  std::uint32_t leaf_, points_;
  const Box& box_;
  Found found_;
  float bound2_ = 0;
};

LeafSearch::Found LeafSearch::nearest(std::uint32_t leaf) const {
  return Query(*this, leaf).run();
}

void measure_spacing_on_host(const NeighbourTree& tree, const float* normal, float* spacing_m) {
  const LeafSearch search(tree);
  const std::uint32_t leaves = (tree.count + LeafSearch::kPoints - 1) / LeafSearch::kPoints;
  using Range = tbb::blocked_range<std::uint32_t>;
  tbb::parallel_for(Range(0, leaves, 128), [&](const Range& range) {
    for (std::uint32_t leaf = range.begin(); leaf < range.end(); ++leaf) {
      const LeafSearch::Found nearest = search.nearest(leaf);
      const std::uint32_t first = leaf * LeafSearch::kPoints;
      for (std::uint32_t i = first; i < std::min(first + LeafSearch::kPoints, tree.count); ++i) {
        spacing_m[i] = spacing_of(nearest[i - first], normal, i, spacing_m[i]);
      }
    }
  });
}

}  // namespace splatbus::capture_bridge

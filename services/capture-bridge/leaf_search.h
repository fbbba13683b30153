#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "capture-bridge/neighbour_tree.h"

namespace splatbus::capture_bridge {

/// NeighbourTree::nearest for all points of a leaf at once, on the host: they share one way through the tree, and their
/// distances to another leaf's points are computed side by side. The tree outlives it; safe on several threads.
class LeafSearch {
 public:
  static constexpr std::uint32_t kPoints = NeighbourTree::kLeafPoints;
  using Found = std::array<Nearest<kSearchedNeighbours>, kPoints>;

  explicit LeafSearch(const NeighbourTree& tree);

  /// The nearest points to each of the leaf's.
  [[nodiscard]] Found nearest(std::uint32_t leaf) const;

 private:
  /// One axis after the other, so that distances are a short loop over arrays.
  struct LeafPoints {
    std::array<float, kPoints> x{}, y{}, z{};
  };
  class Query;

  [[nodiscard]] std::uint32_t points_of(std::uint32_t leaf) const;

  const NeighbourTree& tree_;
  std::vector<LeafPoints> leaves_;
};

/// estimate_spacing (stages.h) over a tree that has been built, on the host. Uses all TBB workers.
void measure_spacing_on_host(const NeighbourTree& tree, const float* normal, float* spacing_m);

}  // namespace splatbus::capture_bridge

#include "capture-bridge/leaf_search.h"
#include "capture-bridge/neighbour_tree.h"
#include "capture-bridge/stages.h"
#include "device/parallel.h"

namespace splatbus::capture_bridge {

namespace {

struct BuildLeaf {
  NeighbourTree tree;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t leaf) const { tree.build_leaf(leaf); }
};

/// A level's nodes begin at `first`, and there are as many.
struct BuildNode {
  NeighbourTree tree;
  std::uint32_t first;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const { tree.build_node(first + i); }
};

struct MeasureSpacing {
  NeighbourTree tree;
  const float* normal;
  float* spacing_m;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    spacing_m[i] = spacing_of(tree.nearest<kSearchedNeighbours>(i), normal, i, spacing_m[i]);
  }
};

}  // namespace

void estimate_spacing(device::StreamView stream, const float* position, const float* normal, std::uint32_t count,
                      float* spacing_m) {
  if (count == 0) return;
  const std::uint32_t leaves = NeighbourTree::leaves_for(count);
  device::Buffer<Box> nodes(stream, 2 * std::size_t{leaves});
  const NeighbourTree tree{position, count, leaves, nodes.data()};
  device::for_each_index(stream, leaves, BuildLeaf{tree});
  for (std::uint32_t first = leaves / 2; first > 0; first /= 2) {
    device::for_each_index(stream, first, BuildNode{tree, first});
  }
  // Point by point takes the host 1.6 to 1.9 times as long as leaf by leaf.
  if (!stream.on_cuda()) return measure_spacing_on_host(tree, normal, spacing_m);
  device::for_each_index(stream, count, MeasureSpacing{tree, normal, spacing_m});
}

}  // namespace splatbus::capture_bridge

#include "capture-bridge/cuda/kernels.h"
#include "capture-bridge/cuda/launch.h"
#include "capture-bridge/spacing_math.h"

namespace splatbus::capture_bridge::cuda {
namespace {

/// Nodes of the levels that one block builds alone.
constexpr std::uint32_t kTopNodes = 1024;

__global__ void leaf_kernel(NeighbourTree tree) {
  const std::uint32_t leaf = item_of_thread();
  if (leaf < tree.leaves) tree.build_leaf(leaf);
}

/// The level whose first node is `first`, and which has as many.
__global__ void level_kernel(NeighbourTree tree, std::uint32_t first) {
  const std::uint32_t i = item_of_thread();
  if (i < first) tree.build_node(first + i);
}

/// The level that begins at `first`, at most kTopNodes, and all above it.
__global__ void top_kernel(NeighbourTree tree, std::uint32_t first) {
  for (std::uint32_t level = first; level > 0; level /= 2) {
    if (threadIdx.x < level) tree.build_node(level + threadIdx.x);
    __syncthreads();
  }
}

__global__ void spacing_kernel(NeighbourTree tree, SampleArrays samples) {
  const std::uint32_t i = item_of_thread();
  if (i >= samples.count) return;
  samples.spacing_m[i] = spacing_of(tree.nearest<kSearchedNeighbours>(i), samples.normal, i, samples.spacing_m[i]);
}

}  // namespace

void launch_spacing(const SampleArrays& samples, Box* nodes, cudaStream_t stream) {
  if (samples.count == 0) return;
  const NeighbourTree tree{samples.position, samples.count, NeighbourTree::leaves_for(samples.count), nodes};
  leaf_kernel<<<blocks_for(tree.leaves), kThreads, 0, stream>>>(tree);
  check_launch("building the neighbour tree");
  std::uint32_t first = tree.leaves / 2;
  for (; first > kTopNodes; first /= 2) {
    level_kernel<<<blocks_for(first), kThreads, 0, stream>>>(tree, first);
    check_launch("building the neighbour tree");
  }
  if (first > 0) {
    top_kernel<<<1, kTopNodes, 0, stream>>>(tree, first);
    check_launch("building the neighbour tree");
  }
  constexpr std::uint32_t kSearchThreads = 128;
  spacing_kernel<<<(samples.count + kSearchThreads - 1) / kSearchThreads, kSearchThreads, 0, stream>>>(tree, samples);
  check_launch("measuring the spacing");
}

}  // namespace splatbus::capture_bridge::cuda

#pragma once

#include "capture-bridge/cuda/round_buffers.h"
#include "capture-bridge/sample_math.h"

// The stages of sampling a round, a few launches each on `stream`, without waiting. All pointers are to device memory.
// They do what their namesakes on the CPU do, with the same functions. Throw std::runtime_error.
namespace splatbus::capture_bridge::cuda {

/// Checks and measures all pixels: depth_m, cosine, object_id, texels; adds to tally->faults.
void launch_surface(const RoundPixels& round, float min_cosine, RoundTally* tally, cudaStream_t stream);

/// ranks; adds to tally->of_rank.
void launch_ranks(const RoundPixels& round, const CullOptions& options, RoundTally* tally, cudaStream_t stream);

/// The samples of rank 1 to cameras_per_surface, `survivors.count` of them, in the order of pixels.
void launch_survivors(const RoundPixels& round, int cameras_per_surface, const Survivors& survivors,
                      Buffer<std::byte>& scratch, std::uint32_t* selected, cudaStream_t stream);

/// memory.order: the survivors along the Morton curve. There is at least one.
void launch_morton_order(const Survivors& survivors, ThinningMemory& memory, cudaStream_t stream);

/// memory.kept: at most `budget` survivors of more than that, `*kept_count` of them.
void launch_thinning(const Survivors& survivors, std::uint32_t budget, ThinningMemory& memory,
                     std::uint32_t* kept_count, cudaStream_t stream);

/// Everything of the samples but their spacing, of which it leaves the fallback. Sample k is survivor kept[k].
void launch_samples(const RoundPixels& round, const Survivors& survivors, const std::uint32_t* kept,
                    float spacing_growth, const LinearTable* linear, const SampleArrays& samples, cudaStream_t stream);

/// spacing_m, where it finds the fallbacks. `nodes`: 2 * NeighbourTree::leaves_for(samples.count).
void launch_spacing(const SampleArrays& samples, Box* nodes, cudaStream_t stream);

/// heights[count]: the samples' y in ascending order; `unsorted` has as much room.
void launch_heights(const SampleArrays& samples, float* unsorted, float* heights, Buffer<std::byte>& scratch,
                    cudaStream_t stream);

}  // namespace splatbus::capture_bridge::cuda

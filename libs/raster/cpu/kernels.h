#pragma once

#include "raster/cpu/frame.h"
#include "raster/cpu/pairs.h"

// The vectorised parts; each picks the best instruction set at run time. All are pure in the range that they are given,
// so ranges may run on different threads.
namespace splatbus::raster::cpu {

/// Projects the Gaussians of a piece (cut_pieces()): writes Frame::splats, reaches, empty pair_ranges if kept, and the
/// keys of those that may be visible, whose number it returns. Non-finite parameters make a Gaussian invisible.
std::size_t project_range(Frame& frame, const IndexRange& piece, DepthKey* visible);

/// Tiles and blocks that the Gaussians [begin, end) of Frame::order reach, in that order; sets their pair_ranges and
/// adds to the counts of the tiles. Gaussians after the first `most` pairs reach nothing.
void collect_pairs(Frame& frame, std::size_t begin, std::size_t end, std::uint32_t piece, std::size_t most,
                   PairBuffer& pairs, std::uint32_t* tile_counts);

/// The same for a frame that is not kept, in wide tiles.
void collect_wide_pairs(Frame& frame, std::size_t begin, std::size_t end, std::size_t most, WidePairBuffer& pairs,
                        std::uint32_t* tile_counts);

/// Blends one tile into the planes of `out`; with Frame::keep it leaves what the backward pass needs.
void blend_tile(Frame& frame, std::uint32_t tile, Render& out);

/// Writes Frame::pair_gradients of every entry of the tile that was blended, and Frame::pair_written of all.
void blend_tile_backward(Frame& frame, std::uint32_t tile, const RenderGradient& gradient);

/// Where project_range_backward() adds: Gaussian i and channel c at values[c * stride + i - origin]. What is not
/// `zeroed` is written first where a Gaussian moves, and stays undefined elsewhere.
struct GradientTarget {
  float* values;
  std::size_t stride, origin;
  bool zeroed;
  int active_channels;
  std::uint8_t* touched;
  float* mean2d_norm;
  float* contribution;
};

/// Sums the pair gradients of a piece's Gaussians and adds their parameters' gradients.
void project_range_backward(const Frame& frame, const IndexRange& piece, const GradientTarget& out);

}  // namespace splatbus::raster::cpu

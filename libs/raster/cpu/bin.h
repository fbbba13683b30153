#pragma once

#include <cstdint>
#include <vector>

#include "raster/cpu/frame.h"
#include "raster/cpu/pairs.h"
#include "raster/cpu/row_scan.h"
#include "raster/cpu/workers.h"

namespace splatbus::raster::cpu {

/// Gives every tile the list of Gaussians that reach it, near to far, from Frame::order: count by tile, prefix sum,
/// fill in order; no list is sorted. Ellipses are intersected exactly with rows of 4x4 blocks.
class TileBinner {
 public:
  void bin(Frame& frame, Workers& workers);

 private:
  struct Piece {
    PairBuffer pairs;                        ///< kept
    WidePairBuffer wide_pairs;               ///< not kept
    std::vector<std::uint32_t> tile_counts;  ///< then where the piece's next entry of the tile goes
  };
  std::vector<Piece> pieces_;
  RowScan scan_;
};

}  // namespace splatbus::raster::cpu

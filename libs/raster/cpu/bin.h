#pragma once

#include <cstdint>
#include <vector>

#include "raster/cpu/frame.h"
#include "raster/cpu/workers.h"

namespace splatbus::raster::cpu {

/// Gives every tile the list of Gaussians that reach it, near to far, from Frame::order: count by tile, prefix sum,
/// fill in order; no list is sorted. Ellipses are intersected exactly with rows of 4x4 blocks.
class TileBinner {
 public:
  void bin(Frame& frame, Workers& workers);

 private:
  struct Pending {
    std::uint32_t tile, gaussian_and_blocks;
  };
  struct Piece {
    std::vector<Pending> pending;
    std::vector<std::uint32_t> tile_counts;  ///< then where the piece's next entry of the tile goes
    std::size_t first_slot = 0;
  };
  static void collect(Frame& frame, std::size_t begin, std::size_t end, std::size_t most, Piece& piece);

  std::vector<Piece> pieces_;
};

}  // namespace splatbus::raster::cpu

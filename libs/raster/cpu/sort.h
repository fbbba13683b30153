#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "raster/cpu/frame.h"
#include "raster/cpu/row_scan.h"
#include "raster/cpu/workers.h"

namespace splatbus::raster::cpu {

/// Stable parallel radix sort by depth_bits; only the bits in which the keys differ are sorted.
class DepthSorter {
 public:
  /// Sorts keys[0, count) in place; `spare` is as large.
  void sort(Scratch<DepthKey>& keys, Scratch<DepthKey>& spare, std::size_t count, Workers& workers);

 private:
  struct Bounds {
    std::uint32_t low, high;
  };
  std::vector<Bounds> bounds_;             ///< [piece]
  std::vector<std::uint32_t> histograms_;  ///< [piece][digit], then where the piece's next key of that digit goes
  std::vector<std::uint32_t> begins_;      ///< [digit + 1]
  RowScan scan_;
};

}  // namespace splatbus::raster::cpu

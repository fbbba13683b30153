#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace splatbus::raster::cpu {

/// Counts of every piece (row) of every bucket (column), turned into where the piece's next item of the bucket goes:
/// bucket after bucket, in it piece after piece. Rows are walked, not columns: whole vectors at a time, and rows a
/// power of two apart do not fight for the same places of the cache.
class RowScan {
 public:
  /// Leaves the first position of every bucket and, last, the end of all in `begins`, which has buckets + 1 entries.
  /// row(piece) is the first of the piece's counts.
  template <class Row>
  void scan(std::size_t pieces, std::size_t buckets, const Row& row, std::uint32_t* begins) {
    next_.assign(buckets, 0);
    std::uint32_t* next = next_.data();
    for (std::size_t piece = 0; piece < pieces; ++piece) {
      const std::uint32_t* counts = row(piece);
      for (std::size_t bucket = 0; bucket < buckets; ++bucket) next[bucket] += counts[bucket];
    }
    std::uint32_t sum = 0;
    for (std::size_t bucket = 0; bucket < buckets; ++bucket) {
      begins[bucket] = sum;
      sum += next[bucket];
      next[bucket] = begins[bucket];
    }
    begins[buckets] = sum;
    for (std::size_t piece = 0; piece < pieces; ++piece) {
      std::uint32_t* counts = row(piece);
      for (std::size_t bucket = 0; bucket < buckets; ++bucket) {
        const std::uint32_t count = counts[bucket];
        counts[bucket] = next[bucket];
        next[bucket] += count;
      }
    }
  }

 private:
  std::vector<std::uint32_t> next_;
};

}  // namespace splatbus::raster::cpu

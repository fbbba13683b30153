#pragma once

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cstddef>
#include <span>

namespace splatbus::stream {

/// Blocks of rows that a worker takes at once.
inline constexpr std::size_t kPieceBlocks = 32;

[[nodiscard]] constexpr std::size_t pieces_of(std::size_t count, std::size_t size) {
  return (count + size - 1) / size;
}

/// Calls f(k, piece) for the k-th `size` of the items, the last piece shorter, in any order, many at a time.
template <class T, class F>
void for_each_piece(std::span<const T> items, std::size_t size, const F& f) {
  tbb::parallel_for(
      tbb::blocked_range<std::size_t>(0, pieces_of(items.size(), size), 1),
      [&](const tbb::blocked_range<std::size_t>& range) {
        for (std::size_t k = range.begin(); k < range.end(); ++k) {
          f(k, items.subspan(k * size, std::min(size, items.size() - k * size)));
        }
      },
      tbb::simple_partitioner());
}

/// Calls f(i) for each i of [0, count), in any order, many at a time.
template <class F>
void for_each_at_once(std::size_t count, const F& f) {
  tbb::parallel_for(std::size_t{0}, count, f);
}

}  // namespace splatbus::stream

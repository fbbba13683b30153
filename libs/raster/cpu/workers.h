#pragma once

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <cstddef>

namespace splatbus::raster::cpu {

/// A bounded set of threads; 0: all cores. Work is cut into pieces whose bounds do not depend on the number of threads.
class Workers {
 public:
  explicit Workers(int threads) : arena_(threads > 0 ? threads : tbb::task_arena::automatic) {}

  /// body(begin, end) for consecutive pieces of [0, count) of at most `piece`.
  template <class Body>
  void for_pieces(std::size_t count, std::size_t piece, const Body& body) {
    if (count == 0) return;
    const std::size_t pieces = (count + piece - 1) / piece;
    if (pieces == 1) {
      body(std::size_t{0}, count);
      return;
    }
    arena_.execute([&] {
      tbb::parallel_for(
          tbb::blocked_range<std::size_t>(0, pieces, 1),
          [&](const tbb::blocked_range<std::size_t>& range) {
            for (std::size_t k = range.begin(); k < range.end(); ++k) body(k * piece, std::min(count, (k + 1) * piece));
          },
          tbb::simple_partitioner());
    });
  }

 private:
  tbb::task_arena arena_;
};

}  // namespace splatbus::raster::cpu

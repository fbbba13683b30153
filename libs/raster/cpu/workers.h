#pragma once

#include <tbb/blocked_range.h>
#include <tbb/info.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <cstddef>

namespace splatbus::raster::cpu {

/// A bounded set of threads; 0: all cores, more than there are count as all. Work is cut into pieces whose bounds do
/// not depend on the number of threads.
class Workers {
 public:
  explicit Workers(int threads) : arena_(concurrency(threads)) {}

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
  static int concurrency(int threads) {
    const int cores = tbb::info::default_concurrency();
    return threads > 0 ? std::min(threads, cores) : cores;
  }

  tbb::task_arena arena_;
};

}  // namespace splatbus::raster::cpu

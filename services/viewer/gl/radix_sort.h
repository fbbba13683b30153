#pragma once

#include <cstddef>

#include "gl/objects.h"

namespace splatbus::viewer::gl {

/// Keys, and what goes with each.
struct Keyed {
  GlBuffer keys, rows;
};

[[nodiscard]] Keyed make_keyed(std::size_t capacity);

/// A stable radix sort on the device, as many keys as the device itself has counted: nothing comes back to the host.
class RadixSort {
 public:
  RadixSort();

  void reserve(std::size_t capacity);
  /// By the lowest `bits` of the keys, ascending; `other` is overwritten. `counted`: a buffer that begins with Counted.
  void run(GLuint counted, Keyed& sorted, Keyed& other, unsigned bits);

 private:
  GlProgram histogram_, scan_counts_, reorder_;
  GlBuffer digit_counts_;
  std::size_t capacity_ = 0;
};

}  // namespace splatbus::viewer::gl

#include "viewer/gl/radix_sort.h"

#include <utility>

#include "gl/program.h"
#include "viewer/gl/shaders.h"
#include "viewer/gl/steps.h"

namespace splatbus::viewer::gl {

Keyed make_keyed(std::size_t capacity) {
  return {make_words(capacity), make_words(capacity)};
}

RadixSort::RadixSort()
    : histogram_(make_compute_program(kHistogramText)),
      scan_counts_(make_compute_program(kScanCountsText)),
      reorder_(make_compute_program(kReorderText)) {}

void RadixSort::reserve(std::size_t capacity) {
  if (capacity <= capacity_) return;
  capacity_ = capacity;
  digit_counts_ = make_words(std::size_t{kDigits} * groups_of(capacity, kBlock));
}

void RadixSort::run(GLuint counted, Keyed& sorted, Keyed& other, unsigned bits) {
  for (unsigned shift = 0; shift < bits; shift += kDigitBits) {
    bind_buffers({counted, sorted.keys.get(), digit_counts_.get()});
    glUseProgram(histogram_.get());
    glUniform1ui(kShift, shift);
    dispatch_indirect(counted, offsetof(Counted, groups));
    next_step();
    bind_buffers({counted, digit_counts_.get()});
    glUseProgram(scan_counts_.get());
    glDispatchCompute(1, 1, 1);
    next_step();
    bind_buffers(
        {counted, sorted.keys.get(), digit_counts_.get(), sorted.rows.get(), other.keys.get(), other.rows.get()});
    glUseProgram(reorder_.get());
    glUniform1ui(kShift, shift);
    dispatch_indirect(counted, offsetof(Counted, groups));
    next_step();
    std::swap(sorted, other);
  }
}

}  // namespace splatbus::viewer::gl

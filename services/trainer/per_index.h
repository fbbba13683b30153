#pragma once

#include <algorithm>
#include <cstddef>
#include <utility>

#include "device/buffer.h"

namespace splatbus::trainer {

/// One value for each index of a model, 0 at first; what there was stays as it grows. In the order of a stream.
template <class T>
class PerIndex {
 public:
  explicit PerIndex(device::StreamView stream) : values_(stream) {}
  void grow(std::size_t count) {
    if (count <= values_.size()) return;
    device::Buffer<T> larger(values_.stream(), std::max(count, 2 * values_.size()));
    larger.clear();
    device::copy(values_.stream(), larger.data(), values_.data(), values_.bytes());
    values_ = std::move(larger);
  }
  [[nodiscard]] T* data() const { return values_.data(); }

 private:
  device::Buffer<T> values_;
};

}  // namespace splatbus::trainer

#pragma once

#include <cstddef>
#include <cstdlib>
#include <memory>

#include "device/large_pages.h"

namespace splatbus::raster::cpu {

/// Growing memory for trivial types that is not initialised: resizing a std::vector would write what is about to be
/// overwritten.
template <class T>
class Scratch {
 public:
  /// Room for `count`; what was there is lost when it has to grow.
  void reserve(std::size_t count) {
    if (count <= capacity_) return;
    storage_.reset();
    capacity_ = 0;
    const std::size_t room = count + count / 4 + 64;
    storage_.reset(static_cast<T*>(device::allocate_large(room * sizeof(T))));  // not initialised
    capacity_ = room;
  }
  [[nodiscard]] T* data() { return storage_.get(); }
  [[nodiscard]] const T* data() const { return storage_.get(); }
  T& operator[](std::size_t i) { return storage_.get()[i]; }
  const T& operator[](std::size_t i) const { return storage_.get()[i]; }

 private:
  struct Free {
    void operator()(T* memory) const { std::free(memory); }
  };
  std::unique_ptr<T, Free> storage_;
  std::size_t capacity_ = 0;
};

}  // namespace splatbus::raster::cpu

#pragma once

#include <cstddef>
#include <memory>

namespace splatbus::raster::cpu {

/// Growing memory for trivial types that is not initialised: resizing a std::vector would write what is about to be
/// overwritten.
template <class T>
class Scratch {
 public:
  /// Room for `count`; what was there is lost when it has to grow.
  void reserve(std::size_t count) {
    if (count <= capacity_) return;
    capacity_ = count + count / 4 + 64;
    const std::size_t bytes = capacity_ * sizeof(T);
    std::size_t room = bytes + kCacheLine;
    storage_ = std::unique_ptr<std::byte[]>(new std::byte[room]);  // not initialised
    void* start = storage_.get();
    data_ = static_cast<T*>(std::align(kCacheLine, bytes, start, room));
  }
  [[nodiscard]] T* data() { return data_; }
  [[nodiscard]] const T* data() const { return data_; }
  T& operator[](std::size_t i) { return data_[i]; }
  const T& operator[](std::size_t i) const { return data_[i]; }

 private:
  static constexpr std::size_t kCacheLine = 64;
  std::unique_ptr<std::byte[]> storage_;
  std::size_t capacity_ = 0;
  T* data_ = nullptr;
};

}  // namespace splatbus::raster::cpu

#pragma once

#include <cuda_runtime_api.h>

#include <cstddef>
#include <utility>

#include "device/check.h"

namespace splatbus::device {

/// Owner of a host array that the device copies to and from without staging; contents are lost when it grows.
template <class T>
class Pinned {
 public:
  Pinned() = default;
  explicit Pinned(std::size_t elements) { resize(elements); }
  ~Pinned() { cudaFreeHost(data_); }
  Pinned(Pinned&& other) noexcept : data_(std::exchange(other.data_, nullptr)), size_(std::exchange(other.size_, 0)) {}
  Pinned& operator=(Pinned&& other) noexcept {
    std::swap(data_, other.data_);
    std::swap(size_, other.size_);
    return *this;
  }

  void resize(std::size_t elements) {
    if (elements > size_) {
      cudaFreeHost(data_);
      data_ = nullptr;
      size_ = 0;
      const std::size_t bytes = elements * sizeof(T);
      check_allocation(cudaMallocHost(reinterpret_cast<void**>(&data_), bytes), "allocating pinned memory", bytes);
      size_ = elements;
    }
  }
  [[nodiscard]] T* data() const { return data_; }
  [[nodiscard]] std::size_t size() const { return size_; }
  [[nodiscard]] T& operator[](std::size_t i) const { return data_[i]; }

 private:
  T* data_ = nullptr;
  std::size_t size_ = 0;
};

}  // namespace splatbus::device

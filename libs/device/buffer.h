#pragma once

#include <cuda_runtime_api.h>

#include <cstddef>
#include <utility>

#include "device/check.h"

namespace splatbus::device {

/// Owner of an array on the current device; its contents are lost when it grows. Copies are enqueued, not waited for.
/// Throws std::runtime_error.
template <class T>
class Buffer {
 public:
  Buffer() = default;
  explicit Buffer(std::size_t elements) { resize(elements); }
  ~Buffer() { cudaFree(data_); }
  Buffer(Buffer&& other) noexcept
      : data_(std::exchange(other.data_, nullptr)),
        size_(std::exchange(other.size_, 0)),
        capacity_(std::exchange(other.capacity_, 0)) {}
  Buffer& operator=(Buffer&& other) noexcept {
    std::swap(data_, other.data_);
    std::swap(size_, other.size_);
    std::swap(capacity_, other.capacity_);
    return *this;
  }
  Buffer(const Buffer&) = delete;
  Buffer& operator=(const Buffer&) = delete;

  void resize(std::size_t elements) {
    if (elements > capacity_) {
      cudaFree(data_);
      data_ = nullptr;
      capacity_ = size_ = 0;
      const std::size_t bytes = elements * sizeof(T);
      check_allocation(cudaMalloc(reinterpret_cast<void**>(&data_), bytes), "allocating a buffer", bytes);
      capacity_ = elements;
    }
    size_ = elements;
  }
  void upload(const T* host, std::size_t elements, cudaStream_t stream) {
    resize(elements);
    check(cudaMemcpyAsync(data_, host, elements * sizeof(T), cudaMemcpyHostToDevice, stream), "copying to the device");
  }
  void download(T* host, std::size_t elements, cudaStream_t stream) const {
    check(cudaMemcpyAsync(host, data_, elements * sizeof(T), cudaMemcpyDeviceToHost, stream), "copying to the host");
  }
  void clear(cudaStream_t stream) { check(cudaMemsetAsync(data_, 0, size_ * sizeof(T), stream), "clearing a buffer"); }

  [[nodiscard]] T* data() const { return data_; }
  [[nodiscard]] std::size_t size() const { return size_; }

 private:
  T* data_ = nullptr;
  std::size_t size_ = 0, capacity_ = 0;
};

}  // namespace splatbus::device

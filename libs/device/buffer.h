#pragma once

#include <cstddef>
#include <span>
#include <type_traits>
#include <utility>
#include <vector>

#include "device/memory.h"

namespace splatbus::device {

/// Owner of an array on a device, in the order of one stream: it may be used, and is given back, behind what is
/// enqueued there. Contents are lost when it grows. Copies are enqueued, not waited for. One thread. Throws as
/// device/memory.h.
template <class T>
class Buffer {
  static_assert(std::is_trivially_copyable_v<T>);

 public:
  /// Without a stream: on CUDA, ordered with nothing, so that allocating and giving back wait for the device.
  Buffer() : stream_{.device = Device::Cuda} {}
  explicit Buffer(std::size_t elements) : Buffer() { resize(elements); }
  explicit Buffer(StreamView stream, std::size_t elements = 0) : stream_(stream) { resize(elements); }
  ~Buffer() { deallocate(stream_, data_); }
  Buffer(Buffer&& other) noexcept
      : stream_(other.stream_),
        data_(std::exchange(other.data_, nullptr)),
        size_(std::exchange(other.size_, 0)),
        capacity_(std::exchange(other.capacity_, 0)) {}
  Buffer& operator=(Buffer&& other) noexcept {
    std::swap(stream_, other.stream_);
    std::swap(data_, other.data_);
    std::swap(size_, other.size_);
    std::swap(capacity_, other.capacity_);
    return *this;
  }
  Buffer(const Buffer&) = delete;
  Buffer& operator=(const Buffer&) = delete;

  void resize(std::size_t elements) {
    if (elements > capacity_) {
      deallocate(stream_, std::exchange(data_, nullptr));
      capacity_ = size_ = 0;
      data_ = static_cast<T*>(allocate(stream_, elements * sizeof(T)));
      capacity_ = elements;
    }
    size_ = elements;
  }

  /// From memory of any device.
  void assign(const T* source, std::size_t elements) {
    resize(elements);
    copy(stream_, data_, source, elements * sizeof(T));
  }
  void assign(std::span<const T> source) { assign(source.data(), source.size()); }
  /// A copy in host memory, waited for.
  [[nodiscard]] std::vector<T> to_host() const {
    std::vector<T> host(size_);
    copy(stream_, host.data(), data_, bytes());
    stream_.wait();
    return host;
  }
  void clear() { fill(stream_, data_, 0, bytes()); }

  // On a stream that is not the buffer's own: the caller sees to the order.
  void upload(const T* host, std::size_t elements, CUstream_st* stream) {
    resize(elements);
    copy({.device = stream_.device, .cuda = stream}, data_, host, elements * sizeof(T));
  }
  void download(T* host, std::size_t elements, CUstream_st* stream) const {
    copy({.device = stream_.device, .cuda = stream}, host, data_, elements * sizeof(T));
  }
  void clear(CUstream_st* stream) { fill({.device = stream_.device, .cuda = stream}, data_, 0, bytes()); }

  [[nodiscard]] T* data() const { return data_; }
  [[nodiscard]] std::size_t size() const { return size_; }
  [[nodiscard]] std::size_t bytes() const { return size_ * sizeof(T); }
  [[nodiscard]] bool empty() const { return size_ == 0; }
  [[nodiscard]] StreamView stream() const { return stream_; }

 private:
  StreamView stream_;
  T* data_ = nullptr;
  std::size_t size_ = 0, capacity_ = 0;
};

/// A copy of the host's values where the stream runs, enqueued.
template <class T>
[[nodiscard]] Buffer<T> uploaded(StreamView stream, std::span<const T> values) {
  Buffer<T> buffer(stream);
  buffer.assign(values);
  return buffer;
}

}  // namespace splatbus::device

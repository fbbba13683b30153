#pragma once

#include <cuda_runtime_api.h>

#include <cstddef>
#include <memory>

namespace splatbus::expander::cuda {

/// The stream of the calling thread: the bus's copies run on it too, so that nothing need wait for them.
inline cudaStream_t thread_stream() {
  return cudaStreamPerThread;
}

/// Device memory in the order of thread_stream(): usable by what is enqueued from now on, and given back, without a
/// wait, behind what was enqueued by the time the last owner lets it go. That is done on the same thread. Throws
/// std::runtime_error.
[[nodiscard]] std::shared_ptr<std::byte> pooled(std::size_t bytes);

/// Memory that is given back stays with the process, for the next round. Throws std::runtime_error.
void keep_pooled_memory();

/// Hands out the parts of one allocation: first counts, then, given memory, points.
class Carver {
 public:
  explicit Carver(std::byte* memory = nullptr) : memory_(memory) {}

  template <class T>
  T* take(std::size_t elements) {
    auto* const part = memory_ == nullptr ? nullptr : reinterpret_cast<T*>(memory_ + used_);
    used_ += (elements * sizeof(T) + kAlignment - 1) / kAlignment * kAlignment;
    return part;
  }
  [[nodiscard]] std::size_t used() const { return used_; }

 private:
  static constexpr std::size_t kAlignment = 256;
  std::byte* memory_;
  std::size_t used_ = 0;
};

}  // namespace splatbus::expander::cuda

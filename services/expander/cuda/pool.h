#pragma once

#include <cuda_runtime_api.h>

#include <cstddef>
#include <memory>

namespace splatbus::expander::cuda {

/// The stream of the calling thread: the bus's copies run on it too, so that nothing need wait for them.
inline cudaStream_t thread_stream() {
  return cudaStreamPerThread;
}

/// Device memory in the order of thread_stream(), within a bound. One thread; blocks may outlive the pool.
class Pool {
 public:
  /// Memory that is given back stays with the process, for the next round. Throws std::runtime_error.
  Pool();

  /// A block, usable by what is enqueued from now on, and given back, without a wait, behind what was enqueued by the
  /// time its last owner lets it go. Throws std::runtime_error that names `what` and how much was asked for when the
  /// bound or the device has no room for it; nothing has changed then.
  [[nodiscard]] std::shared_ptr<std::byte> take(std::size_t bytes, const char* what);

  /// Nothing is handed out that would make it more than so many bytes; what is held stays.
  void limit(std::size_t most_bytes) { account_->most = most_bytes; }
  [[nodiscard]] std::size_t held() const { return account_->held; }

 private:
  struct Account {
    std::size_t held = 0, most = SIZE_MAX;
  };
  std::shared_ptr<Account> account_ = std::make_shared<Account>();  // also its blocks'
};

/// Hands out the parts of one block: first counts, then, given memory, points.
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

/// A block of the parts that `lay_out` takes from a Carver: it is called once without memory, and once with it. Throws
/// as Pool::take does.
template <class LayOut>
[[nodiscard]] std::shared_ptr<std::byte> carve(Pool& pool, const char* what, const LayOut& lay_out) {
  Carver sizes;
  lay_out(sizes);
  std::shared_ptr<std::byte> block = pool.take(sizes.used(), what);
  Carver parts(block.get());
  lay_out(parts);
  return block;
}

}  // namespace splatbus::expander::cuda

#pragma once

#include <cstddef>
#include <memory>

#include "bus/slab.h"

namespace splatbus::bus {

/// Lends memory of one kind and takes it back to lend it again: to allocate and free on the device takes far longer
/// than to fill what is there, and waits for all that runs there. Thread-safe; what it lends may outlive it.
class MemoryPool {
 public:
  /// What nobody has is kept up to `idle_bytes`, or what is reserved where that is more; then what came back longest
  /// ago is freed. A block that is larger is freed at once, and the others stay.
  explicit MemoryPool(Device kind, std::size_t idle_bytes = std::size_t{256} << 20);

  /// At least `bytes`, aligned to 64; what it holds is whatever it held last. It comes back when the last owner lets go
  /// of it, on whichever thread: whoever used it on a stream has waited for that stream. Throws Error.
  [[nodiscard]] std::shared_ptr<std::byte> take(std::size_t bytes);

  /// Sees to it that `count` times so many bytes can be taken without an allocation, and are kept. Throws Error.
  void reserve(std::size_t count, std::size_t bytes);

  [[nodiscard]] Device kind() const { return kind_; }
  [[nodiscard]] std::size_t idle_bytes() const;

 private:
  class Idle;
  Device kind_;
  std::shared_ptr<Idle> idle_;
};

}  // namespace splatbus::bus

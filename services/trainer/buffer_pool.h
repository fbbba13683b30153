#pragma once

#include <cstddef>
#include <memory>

#include "bus/slab.h"

namespace splatbus::trainer {

/// Lends memory of one kind and takes it back to lend it again: to allocate and free on the device waits for all that
/// runs there. What it lends may outlive it. Thread-safe.
class BufferPool {
 public:
  explicit BufferPool(bus::MemoryKind memory);

  /// At least `bytes`, contents undefined; comes back when the last owner lets go, on whichever thread. Whoever works
  /// on it on a stream waits for that first. Throws bus::Error.
  [[nodiscard]] std::shared_ptr<std::byte> take(std::size_t bytes);

 private:
  struct Free;
  bus::MemoryKind memory_;
  std::shared_ptr<Free> free_;
};

}  // namespace splatbus::trainer

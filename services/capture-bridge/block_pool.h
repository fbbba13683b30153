#pragma once

#include <cstddef>
#include <memory>

#include "bus/slab.h"

namespace splatbus::capture_bridge {

/// Blocks of one kind of memory that are used again and again, for allocating device memory takes far longer than
/// filling it. Thread-safe; blocks may outlive the pool.
class BlockPool {
 public:
  explicit BlockPool(bus::MemoryKind kind);

  /// A block of at least `bytes`, aligned to 64; what it holds is whatever it held last. It goes back when the last
  /// owner lets go of it: whoever used it on a stream has waited for that stream. Throws bus::Error.
  [[nodiscard]] std::shared_ptr<std::byte> take(std::size_t bytes);

  /// Sees to it that `count` blocks of so many bytes can be taken without an allocation. Throws bus::Error.
  void reserve(std::size_t count, std::size_t bytes);

  [[nodiscard]] bus::MemoryKind kind() const { return kind_; }

 private:
  struct Idle;
  bus::MemoryKind kind_;
  std::shared_ptr<Idle> idle_;
};

}  // namespace splatbus::capture_bridge

#pragma once

#include <cstddef>
#include <cstdint>

#include "device/buffer.h"
#include "expander/cuda/kernels.h"

namespace splatbus::expander::cuda {

/// Owner of a table of entries by cell; reused from round to round.
class CellTable {
 public:
  CellTable();

  /// Enqueues a table of n > 0 keys, which are not changed.
  void build(const std::uint64_t* keys, std::uint32_t n, cudaStream_t stream);
  /// Enqueues emptying it.
  void clear(cudaStream_t stream);

  /// Good until the next build().
  [[nodiscard]] CellTableView view() const;

 private:
  device::Buffer<std::uint64_t> key_, id_;
  device::Buffer<std::uint32_t> entries_, order_, cell_of_, start_, cells_;
  device::Buffer<std::byte> scratch_;
};

}  // namespace splatbus::expander::cuda

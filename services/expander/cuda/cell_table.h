#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>

#include "expander/cuda/kernels.h"
#include "expander/cuda/pool.h"

namespace splatbus::expander::cuda {

/// Owner of a table of entries by cell; reused from round to round.
class CellTable {
 public:
  explicit CellTable(Pool& pool);

  /// Enqueues a table of n > 0 keys, which are not changed. Throws std::runtime_error when there is no memory for it;
  /// there is no table then.
  void build(const std::uint64_t* keys, std::uint32_t n, cudaStream_t stream);
  /// Enqueues emptying it.
  void clear(cudaStream_t stream);

  /// Good until the next build().
  [[nodiscard]] const CellTableView& view() const { return view_; }

 private:
  void reserve(std::uint32_t n);
  void lay_out(Carver& carver, std::uint32_t n);

  Pool* pool_;
  std::shared_ptr<std::byte> count_, memory_;
  CellTableView view_{};
  std::uint32_t* entries_ = nullptr;
  std::byte* scratch_ = nullptr;
  std::size_t room_ = 0, scratch_bytes_ = 0;
};

}  // namespace splatbus::expander::cuda

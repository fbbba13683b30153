#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

#include "expander/cuda/cell_table.h"
#include "expander/cuda/kernels.h"
#include "expander/cuda/pool.h"

namespace splatbus::expander::cuda {

/// The points that are modelled, in device memory. Work is enqueued on the stream that the functions are given, always
/// the same; those that say so wait for it. Functions throw std::runtime_error when memory or the device fails; the
/// points are what they were then.
class ModelledPoints {
 public:
  explicit ModelledPoints(Pool& pool) : pool_(&pool), table_(pool) {}

  /// Sees to it that `count` points more can be appended without memory being asked for.
  void reserve(std::size_t more, cudaStream_t stream);

  void append(const InsertPlanes& planes, std::uint32_t count, cudaStream_t stream);

  /// Takes a model's points; waits. Points that no cell holds are left out.
  void append(const ModelPlanes& planes, std::uint32_t count, float cell_size_m, cudaStream_t stream);

  void clear() { count_ = 0; }

  /// The points by cell, for kernels that are enqueued next.
  [[nodiscard]] ModelledView view(cudaStream_t stream);

  /// Every cell that holds points, and how many; waits.
  [[nodiscard]] std::vector<std::pair<CellId, std::uint32_t>> cells(cudaStream_t stream);

  [[nodiscard]] std::size_t size() const { return count_; }

 private:
  /// Arrays of `room` points in one block.
  struct Storage {
    std::shared_ptr<std::byte> block;
    ModelledPoint *points = nullptr, *sorted = nullptr;
    std::uint64_t* keys = nullptr;
    std::size_t room = 0;

    void lay_out(Carver& carver, std::size_t count);
  };

  void index(cudaStream_t stream);

  Pool* pool_;
  Storage storage_;
  CellTable table_;
  std::size_t count_ = 0, indexed_ = SIZE_MAX;  // indexed_: points that the table was made of
};

}  // namespace splatbus::expander::cuda

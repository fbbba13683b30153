#pragma once

#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "device/buffer.h"
#include "expander/cuda/cell_table.h"
#include "expander/cuda/kernels.h"

namespace splatbus::expander::cuda {

/// The points that are modelled, in device memory. Work is enqueued on the stream that the functions are given, always
/// the same; those that say so wait for it.
class ModelledPoints {
 public:
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
  void reserve(std::size_t count, cudaStream_t stream);
  void index(cudaStream_t stream);

  device::Buffer<ModelledPoint> points_, sorted_;
  device::Buffer<std::uint64_t> keys_;
  CellTable table_;
  std::size_t count_ = 0, indexed_ = SIZE_MAX;  // indexed_: points that the table was made of
};

}  // namespace splatbus::expander::cuda

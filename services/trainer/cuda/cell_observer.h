#pragma once

#include <cuda_runtime_api.h>

#include <cstddef>
#include <cstdint>
#include <vector>

#include "device/buffer.h"
#include "device/pinned.h"
#include "device/stream.h"
#include "trainer/cell_stats.h"
#include "trainer/cuda/cell_kernels.h"

namespace splatbus::trainer {

/// Samples for a CellTable from a model in device memory: now and then, all Gaussians that contributed to one view at
/// once. The results are small tables that are read when they have long been there. One thread. Throws
/// std::runtime_error naming the CUDA error.
class CellObserver {
 public:
  CellObserver();
  ~CellObserver();
  CellObserver(const CellObserver&) = delete;
  CellObserver& operator=(const CellObserver&) = delete;

  /// Columns came, went or moved. An observation under way still counts.
  void structure_changed() { stale_ = true; }

  /// Counts a step; true when its last view is to be observed.
  [[nodiscard]] bool due();

  /// Enqueues the observation of a view of the step that `stream` has just been given. `observed.contribution` is
  /// filled in here. Not while one is under way().
  void observe(const raster::cuda::DeviceGaussians& gaussians, const cuda::Columns& columns, const std::uint64_t* cell,
               cuda::ObservedView observed, cudaStream_t stream);
  [[nodiscard]] bool under_way() const { return under_way_; }

  /// Takes the results into the table, when they are there or, with `wait`, after waiting for them.
  void collect(bool wait, CellTable& cells);

 private:
  static constexpr int kInterval = 64;      // steps between observations
  static constexpr int kStaleInterval = 8;  // when cells have changed since the last one

  void reserve(std::size_t columns);
  void list(const std::uint64_t* cell, std::size_t count, cudaStream_t stream);

  int steps_ = 0;
  bool stale_ = true, under_way_ = false;
  bool recounted_ = false;  // the observation under way has a new list
  std::size_t most_cells_ = 0;
  device::Buffer<std::uint64_t> sorted_, ids_;
  device::Buffer<std::uint32_t> gaussians_, cell_count_{1};
  device::Buffer<cuda::CellSums> sums_;
  device::Buffer<float> contribution_;
  device::Buffer<std::byte> scratch_;
  device::Pinned<std::uint32_t> host_cell_count_{1};
  device::Stream copies_;
  cudaEvent_t done_ = nullptr;
  std::vector<std::uint64_t> host_ids_;
  std::vector<std::uint32_t> host_gaussians_;
  std::vector<cuda::CellSums> host_sums_;
};

}  // namespace splatbus::trainer

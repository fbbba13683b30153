#pragma once

#include <cuda_runtime_api.h>

#include <cstddef>
#include <cstdint>

#include "raster/cuda/workspace.h"
#include "trainer/cuda/step_kernels.h"

// Figures of grid cells, for CellObserver. Device pointers; all enqueued on `stream`. Throw std::runtime_error naming
// the CUDA error.
namespace splatbus::trainer::cuda {

/// The cells that a model's Gaussians lie in.
struct CellList {
  std::uint64_t* id = nullptr;         ///< [*count] ascending
  std::uint32_t* gaussians = nullptr;  ///< [*count]
  std::uint32_t* count = nullptr;
};

/// Sorts and counts the cells of `count` Gaussians; `sorted` is scratch of as many. `scratch` null: only says in
/// `scratch_bytes` how much is needed.
void list_cells(const std::uint64_t* cell, std::size_t count, std::uint64_t* sorted, const CellList& list,
                void* scratch, std::size_t& scratch_bytes, cudaStream_t stream);

/// Sums over the samples of a cell.
struct CellSums {
  float loss, movement;
  std::uint32_t samples;
};

/// One view of the last training step, as it was rendered.
struct ObservedView {
  raster::cuda::WorkspaceView workspace;
  int view = 0;
  const std::uint8_t* target = nullptr;
  bool display_space = false;           ///< the render needs no sRGB curve
  const float* contribution = nullptr;  ///< [count] largest blending weight in the view
  float min_contribution = 0;
};

/// Adds one sample of each Gaussian that contributed, as CellSampler takes them, to its cell's sums.
void launch_cell_samples(const Columns& columns, const std::uint64_t* cell, const ObservedView& observed,
                         const CellList& list, CellSums* sums, cudaStream_t stream);

}  // namespace splatbus::trainer::cuda

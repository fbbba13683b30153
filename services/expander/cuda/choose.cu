#include <thrust/iterator/counting_iterator.h>

#include <cub/device/device_select.cuh>

#include "device/check.h"
#include "expander/cuda/device_math.cuh"

namespace splatbus::expander::cuda {
namespace {

using device::check;

__device__ std::uint32_t samples_of(const CellTableView& table, std::uint32_t cell) {
  return table.start[cell + 1] - table.start[cell];
}

__device__ bool enough(const CellTableView& table, std::uint32_t cells, CellId id, std::uint32_t least) {
  const int cell = id == kNoCell ? -1 : find_cell(table, cells, id);
  return cell >= 0 && samples_of(table, static_cast<std::uint32_t>(cell)) >= least;
}

/// As Grid::is_seen: itself or a neighbour has enough samples.
__device__ bool is_seen(const CellTableView& table, std::uint32_t cells, std::uint32_t cell, std::uint32_t least) {
  if (samples_of(table, cell) >= least) return true;
  for (int dx = -1; dx <= 1; ++dx) {
    for (int dy = -1; dy <= 1; ++dy) {
      for (int dz = -1; dz <= 1; ++dz) {
        if (enough(table, cells, neighbour_cell(table.id[cell], dx, dy, dz), least)) return true;
      }
    }
  }
  return false;
}

__global__ void judge_cells_kernel(CellTableView table, ModelledView modelled, ChooseOptions options,
                                   ChoiceView choice) {
  const std::uint32_t cell = thread_index();
  const std::uint32_t cells = *table.cells;
  if (cell >= cells) return;
  const int known = find_cell(modelled.cells, *modelled.cells.cells, table.id[cell]);
  const std::uint32_t points = known < 0 ? 0 : samples_of(modelled.cells, static_cast<std::uint32_t>(known));
  const float apart = points == 0 ? options.new_distance : options.top_up_distance;
  choice.apart[cell] = is_seen(table, cells, cell, options.min_samples) ? apart : -1.0F;
  choice.modelled[cell] = points;
  choice.fresh[cell] = 0;
  choice.inserted[cell] = 0;
}

__device__ bool cell_covers(const ModelledView& modelled, int cell, const float3& position, const float3& normal,
                            float distance_m, float same_surface_cosine) {
  if (cell < 0) return false;
  for (std::uint32_t k = modelled.cells.start[cell]; k < modelled.cells.start[cell + 1]; ++k) {
    const ModelledPoint point = modelled.points[k];
    const float3 offset = point.position - position;
    if (dot(offset, offset) < distance_m * distance_m && dot(point.normal, normal) > same_surface_cosine) return true;
  }
  return false;
}

/// As Grid::covered.
__device__ bool covered(const ModelledView& modelled, std::uint32_t cells, CellId cell, const float3& position,
                        const float3& normal, float distance_m, const ChooseOptions& options) {
  const CellCoordinates at = unpack_cell(cell);
  const float3 centre{static_cast<float>(at.x) * options.cell_size_m, static_cast<float>(at.y) * options.cell_size_m,
                      static_cast<float>(at.z) * options.cell_size_m};
  const float3 within = position - centre;
  const float inner = 0.5F * options.cell_size_m - distance_m;
  const int3 low{within.x < -inner, within.y < -inner, within.z < -inner};
  const int3 high{within.x > inner, within.y > inner, within.z > inner};
  for (int dx = -low.x; dx <= high.x; ++dx) {
    for (int dy = -low.y; dy <= high.y; ++dy) {
      for (int dz = -low.z; dz <= high.z; ++dz) {
        const CellId id = neighbour_cell(cell, dx, dy, dz);
        const int known = id == kNoCell ? -1 : find_cell(modelled.cells, cells, id);
        if (cell_covers(modelled, known, position, normal, distance_m, options.same_surface_cosine)) return true;
      }
    }
  }
  return false;
}

/// A thread a sample, in the order of the cells: neighbours in a warp read the same points.
__global__ void test_samples_kernel(RoundView round, Placement placement, CellTableView table, ModelledView modelled,
                                    ChooseOptions options, ChoiceView choice) {
  const std::uint32_t i = thread_index();
  if (i >= round.count) return;
  choice.uncovered[i] = 0;
  if (table.key[i] == kNoCell) return;
  const std::uint32_t cell = table.cell_of[i] - 1;
  if (choice.apart[cell] < 0) return;
  const std::uint32_t sample = table.order[i];
  const float distance_m = fminf(choice.apart[cell] * round.samples.spacing_m[sample], options.cell_size_m);
  const std::uint32_t cells = *modelled.cells.cells;
  if (cells > 0 && covered(modelled, cells, table.key[i], placement.position[sample], placement.normal[sample],
                           distance_m, options)) {
    return;
  }
  choice.uncovered[i] = 1;
  atomicAdd(choice.fresh + cell, 1U);
}

/// A cell that lacks too little of what it holds already is left alone.
__global__ void take_samples_kernel(std::uint32_t n, CellTableView table, ChooseOptions options, ChoiceView choice) {
  const std::uint32_t i = thread_index();
  if (i >= n) return;
  const std::uint32_t sample = table.order[i];
  if (table.key[i] == kNoCell) {
    choice.taken[sample] = 0;
    return;
  }
  const std::uint32_t cell = table.cell_of[i] - 1;
  const float worth = ceilf(options.top_up_fraction * static_cast<float>(choice.modelled[cell]));
  choice.cell_of[sample] = cell;
  choice.taken[sample] = choice.uncovered[i] != 0 && static_cast<float>(choice.fresh[cell]) >= worth ? 1 : 0;
}

__global__ void count_inserted_kernel(std::uint32_t room, ChoiceView choice) {
  const std::uint32_t k = thread_index();
  if (k < min(*choice.count, room)) atomicAdd(choice.inserted + choice.cell_of[choice.chosen[k]], 1U);
}

}  // namespace

std::size_t choose_scratch_bytes(std::uint32_t n) {
  std::size_t bytes = 0;
  check(cub::DeviceSelect::Flagged(nullptr, bytes, thrust::counting_iterator<std::uint32_t>(0),
                                   static_cast<const std::uint8_t*>(nullptr), static_cast<std::uint32_t*>(nullptr),
                                   static_cast<std::uint32_t*>(nullptr), static_cast<int>(n)),
        "sizing the choice of samples");
  return bytes;
}

void launch_choose(const RoundView& round, const Placement& placement, const CellTableView& cells,
                   const ModelledView& modelled, const ChooseOptions& options, const ChoiceView& choice, void* scratch,
                   std::size_t scratch_bytes, cudaStream_t stream) {
  const unsigned blocks = blocks_for(round.count);
  judge_cells_kernel<<<blocks, kThreads, 0, stream>>>(cells, modelled, options, choice);
  check(cudaGetLastError(), "judging cells");
  test_samples_kernel<<<blocks, kThreads, 0, stream>>>(round, placement, cells, modelled, options, choice);
  check(cudaGetLastError(), "testing samples");
  take_samples_kernel<<<blocks, kThreads, 0, stream>>>(round.count, cells, options, choice);
  check(cudaGetLastError(), "taking samples");
  check(cub::DeviceSelect::Flagged(scratch, scratch_bytes, thrust::counting_iterator<std::uint32_t>(0), choice.taken,
                                   choice.chosen, choice.count, static_cast<int>(round.count), stream),
        "choosing samples");
  count_inserted_kernel<<<blocks, kThreads, 0, stream>>>(options.room, choice);
  check(cudaGetLastError(), "counting chosen samples");
}

}  // namespace splatbus::expander::cuda

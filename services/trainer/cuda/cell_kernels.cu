#include <cub/device/device_radix_sort.cuh>
#include <cub/device/device_run_length_encode.cuh>

#include "device/sorted.cuh"
#include "device/srgb.cuh"
#include "gaussians/layout.h"
#include "trainer/cuda/cell_kernels.h"

namespace splatbus::trainer::cuda {
namespace {

using device::check;

constexpr int kThreads = 256;

__device__ float pixel_error(const ObservedView& o, std::size_t pixel) {
  const auto pixels = static_cast<std::size_t>(o.workspace.width) * static_cast<std::size_t>(o.workspace.height);
  const float* color = o.workspace.color + 3 * pixels * static_cast<std::size_t>(o.view) + pixel;
  float error = 0.0F;
  for (std::size_t c = 0; c < 3; ++c) {
    const float value = fminf(fmaxf(color[c * pixels], 0.0F), 1.0F);
    const float shown = o.display_space ? value : device::srgb_from_linear(value);
    error += fabsf(shown - static_cast<float>(o.target[4 * pixel + c]) / 255.0F);
  }
  return error / 3.0F;
}

__global__ void cell_samples_kernel(Columns c, const std::uint64_t* cell, ObservedView o, CellList list,
                                    CellSums* sums) {
  const int i = static_cast<int>(blockIdx.x) * kThreads + static_cast<int>(threadIdx.x);
  if (i >= c.count || !(o.contribution[i] >= o.min_contribution)) return;
  const float4 shape =
      o.workspace.projected_shape[2 * (static_cast<std::size_t>(o.view) * static_cast<std::size_t>(o.workspace.count) +
                                    static_cast<std::size_t>(i))];
  const auto width = static_cast<float>(o.workspace.width), height = static_cast<float>(o.workspace.height);
  if (!(shape.x >= 0.0F && shape.y >= 0.0F && shape.x < width && shape.y < height)) return;
  const std::size_t pixel = static_cast<std::size_t>(shape.y) * static_cast<std::size_t>(o.workspace.width) +
                            static_cast<std::size_t>(shape.x);
  float moved2 = 0.0F, largest = -INFINITY;
  for (int k = 0; k < 3; ++k) {
    const std::int64_t channel = (ParameterLayout::kMean + k) * c.stride + i;
    const float moved = c.parameters[channel] - c.average[channel];
    moved2 += moved * moved;
    largest = fmaxf(largest, c.parameters[(ParameterLayout::kLogScale + k) * c.stride + i]);
  }
  const int at = device::find_sorted(list.id, *list.count, cell[i]);
  if (at < 0) return;
  atomicAdd(&sums[at].loss, pixel_error(o, pixel));
  atomicAdd(&sums[at].movement, sqrtf(moved2) / fmaxf(expf(largest), 1e-6F));
  atomicAdd(&sums[at].samples, 1U);
}

}  // namespace

void list_cells(const std::uint64_t* cell, std::size_t count, std::uint64_t* sorted, const CellList& list,
                void* scratch, std::size_t& scratch_bytes, cudaStream_t stream) {
  const auto items = static_cast<int>(count);
  std::size_t sort_bytes = 0, encode_bytes = 0;
  check(cub::DeviceRadixSort::SortKeys(nullptr, sort_bytes, cell, sorted, items), "sizing a sort of cells");
  check(cub::DeviceRunLengthEncode::Encode(nullptr, encode_bytes, sorted, list.id, list.gaussians, list.count, items),
        "sizing a count of cells");
  if (scratch == nullptr) {
    scratch_bytes = sort_bytes > encode_bytes ? sort_bytes : encode_bytes;
    return;
  }
  std::size_t bytes = scratch_bytes;
  check(cub::DeviceRadixSort::SortKeys(scratch, bytes, cell, sorted, items, 0, 64, stream), "sorting cells");
  bytes = scratch_bytes;
  check(cub::DeviceRunLengthEncode::Encode(scratch, bytes, sorted, list.id, list.gaussians, list.count, items, stream),
        "counting cells");
}

void launch_cell_samples(const Columns& columns, const std::uint64_t* cell, const ObservedView& observed,
                         const CellList& list, CellSums* sums, cudaStream_t stream) {
  if (columns.count == 0) return;
  const auto blocks = static_cast<unsigned>((columns.count + kThreads - 1) / kThreads);
  cell_samples_kernel<<<blocks, kThreads, 0, stream>>>(columns, cell, observed, list, sums);
  check(cudaGetLastError(), "sampling cells");
}

}  // namespace splatbus::trainer::cuda

#include <thrust/iterator/counting_iterator.h>
#include <thrust/iterator/transform_iterator.h>

#include <algorithm>
#include <cub/device/device_radix_sort.cuh>
#include <cub/device/device_scan.cuh>

#include "device/check.h"
#include "expander/cuda/device_math.cuh"

namespace splatbus::expander::cuda {
namespace {

using device::check;

/// 1 where a cell begins.
struct BeginsCell {
  const std::uint64_t* key;
  __device__ std::uint32_t operator()(std::uint32_t i) const {
    return key[i] != kNoCell && (i == 0 || key[i] != key[i - 1]) ? 1U : 0U;
  }
};

auto beginnings(const std::uint64_t* key) {
  return thrust::make_transform_iterator(thrust::counting_iterator<std::uint32_t>(0), BeginsCell{key});
}

__global__ void number_kernel(std::uint32_t* entries, std::uint32_t n) {
  const std::uint32_t i = thread_index();
  if (i < n) entries[i] = i;
}

__global__ void list_cells_kernel(CellTableView table, std::uint32_t n) {
  const std::uint32_t i = thread_index();
  if (i >= n) return;
  const std::uint64_t key = table.key[i];
  if (key == kNoCell) return;
  const std::uint32_t cell = table.cell_of[i];
  if (BeginsCell{table.key}(i) != 0) {
    table.id[cell - 1] = key;
    table.start[cell - 1] = i;
  }
  if (i + 1 == n || table.key[i + 1] == kNoCell) {
    table.start[cell] = i + 1;
    *table.cells = cell;
  }
}

}  // namespace

std::size_t cell_table_scratch_bytes(std::uint32_t n) {
  std::size_t sort = 0, scan = 0;
  check(cub::DeviceRadixSort::SortPairs(
            nullptr, sort, static_cast<const std::uint64_t*>(nullptr), static_cast<std::uint64_t*>(nullptr),
            static_cast<const std::uint32_t*>(nullptr), static_cast<std::uint32_t*>(nullptr), static_cast<int>(n)),
        "sizing the sort of cells");
  check(cub::DeviceScan::InclusiveSum(nullptr, scan, beginnings(nullptr), static_cast<std::uint32_t*>(nullptr),
                                      static_cast<int>(n)),
        "sizing the scan of cells");
  return std::max(sort, scan);
}

void launch_cell_table(const std::uint64_t* keys, std::uint32_t n, std::uint32_t* entries, const CellTableView& table,
                       void* scratch, std::size_t scratch_bytes, cudaStream_t stream) {
  check(cudaMemsetAsync(table.cells, 0, sizeof(std::uint32_t), stream), "clearing a count");
  check(cudaMemsetAsync(table.start, 0, sizeof(std::uint32_t), stream), "clearing a count");
  number_kernel<<<blocks_for(n), kThreads, 0, stream>>>(entries, n);
  check(cudaGetLastError(), "numbering");
  check(cub::DeviceRadixSort::SortPairs(scratch, scratch_bytes, keys, table.key, entries, table.order,
                                        static_cast<int>(n), 0, 64, stream),
        "sorting by cell");
  check(cub::DeviceScan::InclusiveSum(scratch, scratch_bytes, beginnings(table.key), table.cell_of, static_cast<int>(n),
                                      stream),
        "counting cells");
  list_cells_kernel<<<blocks_for(n), kThreads, 0, stream>>>(table, n);
  check(cudaGetLastError(), "listing cells");
}

}  // namespace splatbus::expander::cuda

#include "expander/cuda/cell_table.h"

#include "device/check.h"

namespace splatbus::expander::cuda {

CellTable::CellTable(Pool& pool) : pool_(&pool), count_(pool.take(sizeof(std::uint32_t), "a count of cells")) {
  view_.cells = reinterpret_cast<std::uint32_t*>(count_.get());
}

void CellTable::lay_out(Carver& carver, std::uint32_t n) {
  for (std::uint64_t** ids : {&view_.key, &view_.id}) *ids = carver.take<std::uint64_t>(n);
  for (std::uint32_t** indices : {&entries_, &view_.order, &view_.cell_of}) *indices = carver.take<std::uint32_t>(n);
  view_.start = carver.take<std::uint32_t>(std::size_t{n} + 1);
  scratch_ = carver.take<std::byte>(scratch_bytes_);
}

void CellTable::reserve(std::uint32_t n) {
  const std::size_t scratch_bytes = cell_table_scratch_bytes(n);
  if (n <= room_ && scratch_bytes <= scratch_bytes_) return;
  memory_.reset();
  room_ = 0;
  scratch_bytes_ = scratch_bytes;
  memory_ = carve(*pool_, "a table of cells", [&](Carver& carver) { lay_out(carver, n); });
  room_ = n;
}

void CellTable::build(const std::uint64_t* keys, std::uint32_t n, cudaStream_t stream) {
  reserve(n);
  launch_cell_table(keys, n, entries_, view_, scratch_, scratch_bytes_, stream);
}

void CellTable::clear(cudaStream_t stream) {
  device::check(cudaMemsetAsync(view_.cells, 0, sizeof(std::uint32_t), stream), "emptying a table of cells");
}

}  // namespace splatbus::expander::cuda

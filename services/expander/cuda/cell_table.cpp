#include "expander/cuda/cell_table.h"

namespace splatbus::expander::cuda {

CellTable::CellTable() : start_(1), cells_(1) {}

void CellTable::build(const std::uint64_t* keys, std::uint32_t n, cudaStream_t stream) {
  for (auto* buffer : {&key_, &id_}) buffer->resize(n);
  for (auto* buffer : {&entries_, &order_, &cell_of_}) buffer->resize(n);
  start_.resize(std::size_t{n} + 1);
  scratch_.resize(cell_table_scratch_bytes(n));
  launch_cell_table(keys, n, entries_.data(), view(), scratch_.data(), scratch_.size(), stream);
}

void CellTable::clear(cudaStream_t stream) {
  cells_.clear(stream);
}

CellTableView CellTable::view() const {
  return {.key = key_.data(),
          .order = order_.data(),
          .cell_of = cell_of_.data(),
          .id = id_.data(),
          .start = start_.data(),
          .cells = cells_.data()};
}

}  // namespace splatbus::expander::cuda

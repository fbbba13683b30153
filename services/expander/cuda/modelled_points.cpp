#include "expander/cuda/modelled_points.h"

#include <algorithm>

#include "device/check.h"

namespace splatbus::expander::cuda {

namespace {

using device::check;

constexpr std::size_t kLeastRoom = std::size_t{1} << 20;

template <class T>
void copy(T* to, const T* from, std::size_t count, cudaStream_t stream) {
  if (count == 0) return;
  check(cudaMemcpyAsync(to, from, count * sizeof(T), cudaMemcpyDeviceToDevice, stream), "moving points");
}

}  // namespace

void ModelledPoints::Storage::lay_out(Carver& carver, std::size_t count) {
  for (ModelledPoint** array : {&points, &sorted}) *array = carver.take<ModelledPoint>(count);
  keys = carver.take<std::uint64_t>(count);
  room = count;
}

void ModelledPoints::reserve(std::size_t more, cudaStream_t stream) {
  if (count_ + more <= storage_.room) return;
  const std::size_t room = std::max({count_ + more, 2 * storage_.room, kLeastRoom});
  Storage larger;
  larger.block = carve(*pool_, "what is modelled", [&](Carver& carver) { larger.lay_out(carver, room); });
  copy(larger.points, storage_.points, count_, stream);
  copy(larger.keys, storage_.keys, count_, stream);
  storage_ = std::move(larger);
}

void ModelledPoints::append(const InsertPlanes& planes, std::uint32_t count, cudaStream_t stream) {
  if (count == 0) return;
  reserve(count, stream);
  launch_points_of_batch(planes, count, storage_.points + count_, storage_.keys + count_, stream);
  count_ += count;
  indexed_ = SIZE_MAX;
}

void ModelledPoints::append(const ModelPlanes& planes, std::uint32_t count, float cell_size_m, cudaStream_t stream) {
  if (count == 0) return;
  reserve(count, stream);
  launch_points_of_model(planes, count, cell_size_m, storage_.points + count_, storage_.keys + count_, stream);
  count_ += count;
  indexed_ = SIZE_MAX;
  std::size_t held = 0;
  for (const auto& [cell, points] : cells(stream)) held += points;
  count_ = indexed_ = held;  // the others were sorted behind
}

void ModelledPoints::index(cudaStream_t stream) {
  if (indexed_ == count_) return;
  if (count_ == 0) {
    table_.clear(stream);
  } else {
    const auto count = static_cast<std::uint32_t>(count_);
    indexed_ = SIZE_MAX;  // should there be no memory for the table
    table_.build(storage_.keys, count, stream);
    launch_gather(storage_.points, table_.view().order, count, storage_.sorted, stream);
    std::swap(storage_.points, storage_.sorted);
    copy(storage_.keys, table_.view().key, count_, stream);
  }
  indexed_ = count_;
}

ModelledView ModelledPoints::view(cudaStream_t stream) {
  index(stream);
  return {.points = storage_.points, .cells = table_.view()};
}

std::vector<std::pair<CellId, std::uint32_t>> ModelledPoints::cells(cudaStream_t stream) {
  const CellTableView table = view(stream).cells;
  std::uint32_t count = 0;
  check(cudaMemcpyAsync(&count, table.cells, sizeof(count), cudaMemcpyDeviceToHost, stream), "reading cells");
  check(cudaStreamSynchronize(stream), "waiting for cells");
  std::vector<CellId> ids(count);
  std::vector<std::uint32_t> start(std::size_t{count} + 1);
  if (count > 0) {
    check(cudaMemcpyAsync(ids.data(), table.id, ids.size() * sizeof(CellId), cudaMemcpyDeviceToHost, stream),
          "reading cells");
    check(cudaMemcpyAsync(start.data(), table.start, start.size() * sizeof(std::uint32_t), cudaMemcpyDeviceToHost,
                          stream),
          "reading cells");
    check(cudaStreamSynchronize(stream), "waiting for cells");
  }
  std::vector<std::pair<CellId, std::uint32_t>> cells(count);
  for (std::size_t i = 0; i < count; ++i) cells[i] = {ids[i], start[i + 1] - start[i]};
  return cells;
}

}  // namespace splatbus::expander::cuda

#include "expander/cuda/modelled_points.h"

#include <algorithm>

namespace splatbus::expander::cuda {

namespace {

using device::check;

constexpr std::size_t kLeastRoom = std::size_t{1} << 20;

template <class T>
void grow(device::Buffer<T>& buffer, std::size_t used, std::size_t room, cudaStream_t stream) {
  device::Buffer<T> larger(room);
  if (used > 0) {
    check(cudaMemcpyAsync(larger.data(), buffer.data(), used * sizeof(T), cudaMemcpyDeviceToDevice, stream),
          "moving points");
  }
  std::swap(buffer, larger);  // the old one is freed when the copy is done: cudaFree waits
}

}  // namespace

void ModelledPoints::reserve(std::size_t count, cudaStream_t stream) {
  // Both are asked: when there was memory for the first alone, the second stayed as it was.
  if (count <= std::min(points_.size(), keys_.size())) return;
  const std::size_t room = std::max({count, 2 * keys_.size(), kLeastRoom});
  grow(points_, count_, room, stream);
  grow(keys_, count_, room, stream);
}

void ModelledPoints::append(const InsertPlanes& planes, std::uint32_t count, cudaStream_t stream) {
  if (count == 0) return;
  reserve(count_ + count, stream);
  launch_points_of_batch(planes, count, points_.data() + count_, keys_.data() + count_, stream);
  count_ += count;
  indexed_ = SIZE_MAX;
}

void ModelledPoints::append(const ModelPlanes& planes, std::uint32_t count, float cell_size_m, cudaStream_t stream) {
  if (count == 0) return;
  reserve(count_ + count, stream);
  launch_points_of_model(planes, count, cell_size_m, points_.data() + count_, keys_.data() + count_, stream);
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
    table_.build(keys_.data(), count, stream);
    sorted_.resize(points_.size());
    launch_gather(points_.data(), table_.view().order, count, sorted_.data(), stream);
    std::swap(points_, sorted_);
    check(cudaMemcpyAsync(keys_.data(), table_.view().key, count_ * sizeof(std::uint64_t), cudaMemcpyDeviceToDevice,
                          stream),
          "keeping the cells of points");
  }
  indexed_ = count_;
}

ModelledView ModelledPoints::view(cudaStream_t stream) {
  index(stream);
  return {.points = points_.data(), .cells = table_.view()};
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

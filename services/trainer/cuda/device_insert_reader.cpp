#include "trainer/cuda/device_insert_reader.h"

#include <algorithm>
#include <utility>

#include "bus/memory.h"
#include "trainer/cuda/insert_kernels.h"
#include "trainer/memory_failure.h"

namespace splatbus::trainer::cuda {

DeviceInsertReader::DeviceInsertReader(std::atomic<std::uint64_t>& host_bytes)
    : host_bytes_(host_bytes), kept_(1), host_kept_(1) {}

InsertReading DeviceInsertReader::read(const bus::Message& message) {
  InsertReading reading;
  const auto tensors = find_insert_tensors(message, reading.batch);
  reading.lost = !tensors;
  if (!tensors || tensors->rows == 0) return reading;
  in_own_memory([&] {
    reading.lost = !copy(*tensors);
    if (!reading.lost) keep_valid_rows(reading.batch, tensors->rows);
  });
  return reading;
}

bool DeviceInsertReader::copy(const InsertTensors& tensors) {
  announced_.resize(insert_rows_bytes(tensors.rows));
  std::byte* to = announced_.data();
  std::uint64_t from_host = 0;
  for (const bus::TensorView& plane : tensors.planes) {
    bus::copy_memory(to, Device::Cuda, plane.data(), plane.memory(), plane.bytes());
    to += plane.bytes();
    if (plane.memory() == Device::Cpu) from_host += plane.bytes();
  }
  bus::finish_copies();
  host_bytes_ += from_host;
  return std::all_of(tensors.planes.begin(), tensors.planes.end(),
                     [](const bus::TensorView& plane) { return plane.still_valid(); });
}

void DeviceInsertReader::keep_valid_rows(InsertBatch& batch, std::uint32_t rows) {
  const InsertRows announced = insert_rows_at(announced_.data(), rows);
  valid_.resize(rows);
  keep_.resize(rows);
  scratch_.resize(valid_rows_scratch_bytes(rows));
  launch_find_valid_rows(announced, rows, valid_.data(), keep_.data(), kept_.data(), scratch_.data(), scratch_.size(),
                         stream_.get());
  auto memory = pool_.take(insert_rows_bytes(rows));
  batch.device_rows = insert_rows_at(memory.get(), rows);
  launch_gather_rows(announced, rows, keep_.data(), kept_.data(), batch.device_rows, stream_.get());
  kept_.download(host_kept_.data(), 1, stream_.get());
  stream_.wait();
  batch.device_memory = std::move(memory);
  batch.count = host_kept_[0];
  batch.dropped = rows - batch.count;
}

}  // namespace splatbus::trainer::cuda

#include "trainer/insert_reader.h"

#include <algorithm>
#include <optional>
#include <string>
#include <type_traits>
#include <utility>

#include "bus/error.h"
#include "bus/memory.h"
#include "trainer/memory_failure.h"
#include "wire/convert.h"
#include "wire/model_generated.h"

namespace splatbus::trainer {

namespace {

/// In the order in which insert_rows_at() lays them out. Nullopt when the slab has moved on.
std::optional<std::vector<bus::TensorView>> find_planes(const bus::Message& message, std::uint32_t rows) {
  std::vector<bus::TensorView> planes;
  bool lost = rows == 0;
  const InsertRows described;
  for_each_plane(described, [&]<class T>(const char* name, const T* /*planes*/, std::uint32_t channels) {
    std::vector<std::uint32_t> shape{rows};
    if (std::is_floating_point_v<T>) shape.insert(shape.begin(), channels);
    auto tensor = message.tensor(name, bus::ElementTypeOf<T>::value, shape);
    if (!tensor && !message.announces(name)) {
      throw bus::Error(message.topic() + " from " + message.header().source()->str() + ": tensor \"" + name +
                       "\" is missing");
    }
    lost = lost || !tensor;
    if (tensor) planes.push_back(std::move(*tensor));
  });
  if (lost) return std::nullopt;
  return planes;
}

}  // namespace

std::size_t insert_rows_bytes(std::size_t stride) {
  std::size_t bytes = 0;
  InsertRows rows;
  for_each_plane(rows, [&](const char* /*name*/, const auto* planes, std::size_t channels) {
    bytes += channels * stride * sizeof(*planes);
  });
  return bytes;
}

InsertRows insert_rows_at(const std::byte* memory, std::size_t stride) {
  InsertRows rows{.stride = stride};
  for_each_plane(rows, [&]<class T>(const char* /*name*/, const T*& planes, std::size_t channels) {
    planes = reinterpret_cast<const T*>(memory);
    memory += channels * stride * sizeof(T);
  });
  return rows;
}

InsertReader::InsertReader(Device device, std::atomic<std::uint64_t>& host_bytes)
    : device_(device), host_bytes_(host_bytes), stream_(device), pool_(device), announced_(stream_) {}

InsertReading InsertReader::read(const bus::Message& message) {
  const auto& insert = message.root<wire::ModelInsert>();
  InsertReading reading;
  InsertBatch& batch = reading.batch;
  batch.epoch = message.header().epoch();
  batch.batch = insert.batch();
  batch.scene = {.light = from_wire(*insert.light()), .objects = from_wire(insert.objects())};
  const auto mean = message.tensor("mean", bus::ElementType::F32, {3, 0});
  const std::uint32_t rows = mean ? mean->dim(1) : 0;
  if (mean && rows == 0) return reading;
  if (rows > kMaxInsertRows) {
    throw bus::Error(message.topic() + ": " + std::to_string(rows) + " Gaussians in one batch, more than " +
                     std::to_string(kMaxInsertRows));
  }
  const auto planes = find_planes(message, rows);
  reading.lost = !planes;
  if (reading.lost) return reading;
  in_own_memory([&] {
    reading.lost = !copy(*planes, rows);
    if (reading.lost) return;
    batch.memory = pool_.take(insert_rows_bytes(rows));
    batch.rows = insert_rows_at(batch.memory.get(), rows);
    batch.count = keep_valid_rows(stream_, insert_rows_at(announced_.data(), rows), rows, batch.rows);
    batch.dropped = rows - batch.count;
  });
  return reading;
}

bool InsertReader::copy(const std::vector<bus::TensorView>& planes, std::uint32_t rows) {
  announced_.resize(insert_rows_bytes(rows));
  stream_.wait();
  std::byte* to = announced_.data();
  std::uint64_t through_host = 0;
  for (const bus::TensorView& plane : planes) {
    bus::copy_memory(to, device_, plane.data(), plane.memory(), plane.bytes());
    to += plane.bytes();
    if (device_ == Device::Cpu || plane.memory() == Device::Cpu) through_host += plane.bytes();
  }
  bus::finish_copies();
  host_bytes_ += through_host;
  return std::all_of(planes.begin(), planes.end(), [](const bus::TensorView& plane) { return plane.still_valid(); });
}

}  // namespace splatbus::trainer

#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "bus/memory_pool.h"
#include "bus/subscriber.h"
#include "device/buffer.h"
#include "device/stream.h"
#include "gaussians/light.h"
#include "trainer/insert_rows.h"

namespace splatbus::trainer {

/// Bytes of rows that lie in one piece, and where their planes are in it.
[[nodiscard]] std::size_t insert_rows_bytes(std::size_t stride);
[[nodiscard]] InsertRows insert_rows_at(const std::byte* memory, std::size_t stride);

/// New Gaussians in memory of our own, checked: everything finite, rotations and normals unit, albedo and visibility in
/// [0, 1]. Frames as in wire::ModelInsert.
struct InsertBatch {
  std::uint64_t epoch = 0;  ///< of the expander
  std::uint64_t batch = 0;  ///< unique within the epoch
  std::size_t count = 0;
  std::size_t dropped = 0;  ///< rows that were not finite or without a direction
  std::shared_ptr<const std::byte> memory;
  InsertRows rows;   ///< in that memory
  SceneState scene;  ///< under which the samples were seen
};

struct InsertReading {
  bool lost = false;
  InsertBatch batch;
};

/// Copies model/insert messages out of the expander's slab, whichever memory that lies in, into memory of one device,
/// and checks every row there. One thread.
class InsertReader {
 public:
  /// What passes through the host is added to `host_bytes`.
  InsertReader(Device device, std::atomic<std::uint64_t>& host_bytes);

  /// `lost` when the slab moved on meanwhile (the expander repeats the batch). Throws bus::Error or std::runtime_error
  /// when the message lies about its tensors, MemoryFailure.
  [[nodiscard]] InsertReading read(const bus::Message& message);

 private:
  /// False when the slab moved on.
  [[nodiscard]] bool copy(const std::vector<bus::TensorView>& planes, std::uint32_t rows);

  Device device_;
  std::atomic<std::uint64_t>& host_bytes_;
  device::Stream stream_;
  bus::MemoryPool pool_;
  device::Buffer<std::byte> announced_;
};

}  // namespace splatbus::trainer

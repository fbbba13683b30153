#pragma once

#include "bus/memory_pool.h"
#include "device/buffer.h"
#include "device/pinned.h"
#include "device/stream.h"
#include "trainer/insert_reader.h"

namespace splatbus::trainer::cuda {

/// Rows that lie on the device are copied and checked there; rows of a host's slab are uploaded first. Waits for the
/// device twice a message, each time for work on its own stream only.
class DeviceInsertReader final : public InsertReader {
 public:
  explicit DeviceInsertReader(std::atomic<std::uint64_t>& host_bytes);
  [[nodiscard]] InsertReading read(const bus::Message& message) override;

 private:
  [[nodiscard]] bool copy(const InsertTensors& tensors);
  void keep_valid_rows(InsertBatch& batch, std::uint32_t rows);

  std::atomic<std::uint64_t>& host_bytes_;
  device::Stream stream_;
  bus::MemoryPool pool_{Device::Cuda};
  device::Buffer<std::byte> announced_, scratch_;
  device::Buffer<std::uint8_t> valid_;
  device::Buffer<std::uint32_t> keep_, kept_;
  device::Pinned<std::uint32_t> host_kept_;
};

}  // namespace splatbus::trainer::cuda

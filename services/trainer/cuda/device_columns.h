#pragma once

#include "device/buffer.h"
#include "device/pinned.h"
#include "device/stream.h"
#include "trainer/cuda/column_kernels.h"
#include "trainer/model_columns.h"

namespace splatbus::trainer::cuda {

/// ModelColumns of planes in device memory. Works on a stream of its own and waits for it before it returns. Throws
/// std::runtime_error naming the CUDA error.
class DeviceColumns final : public ModelColumns {
 public:
  DeviceColumns();

  void append(const ModelPlanes& planes, const InsertBatch& batch, std::size_t first, std::size_t count,
              std::uint64_t first_id) override;
  void duplicate(const ModelPlanes& planes, std::span<const std::uint32_t> columns, std::size_t first,
                 std::uint64_t first_id) override;
  ColumnMoves remove(const ModelPlanes& planes, std::size_t count, const std::uint8_t* dead) override;
  void set_visibility(const ModelPlanes& planes, const float* values, Device memory, std::size_t count) override;
  Inspection inspect(const ModelPlanes& planes, std::size_t count) override;

 private:
  [[nodiscard]] InsertRows upload(const InsertRows& rows, std::size_t count);
  /// Runs what adds to a counter on the device; what it came to.
  template <class Launch>
  std::uint32_t counted(Launch&& launch);

  device::Stream stream_;
  device::Buffer<std::byte> rows_, scratch_;
  device::Buffer<std::uint8_t> marks_;
  device::Buffer<std::uint32_t> from_, to_, counter_;
  device::Buffer<ObjectRotation> objects_;
  device::Buffer<float> values_;
  device::Pinned<std::uint32_t> host_counter_;
};

}  // namespace splatbus::trainer::cuda

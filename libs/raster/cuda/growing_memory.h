#pragma once

#include <cuda_runtime_api.h>

#include <cstddef>
#include <cstdint>
#include <vector>

namespace splatbus::raster::cuda {

/// Device memory that grows at its end and is never moved or copied: addresses for all that may come are reserved, and
/// memory is mapped there piece by piece. Throws std::runtime_error naming the CUDA error.
class GrowingMemory {
 public:
  /// Reserves addresses of the present device at the first growth.
  explicit GrowingMemory(std::size_t max_bytes) : max_bytes_(max_bytes) {}
  ~GrowingMemory();
  GrowingMemory(GrowingMemory&& other) noexcept;
  GrowingMemory& operator=(GrowingMemory&& other) noexcept;

  /// To at least `bytes`; what is new is zero for what follows on the stream.
  void grow(std::size_t bytes, cudaStream_t stream);

  /// Null while it is empty.
  [[nodiscard]] std::byte* data() const { return data_; }
  [[nodiscard]] std::size_t bytes() const { return bytes_; }

 private:
  std::size_t max_bytes_, reserved_ = 0, bytes_ = 0;
  std::byte* data_ = nullptr;
  std::vector<std::size_t> pieces_;  // bytes of each
};

}  // namespace splatbus::raster::cuda

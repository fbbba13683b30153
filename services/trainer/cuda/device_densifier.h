#pragma once

#include <cuda_runtime_api.h>

#include <cstddef>
#include <cstdint>
#include <vector>

#include "device/buffer.h"
#include "device/pinned.h"
#include "raster/cuda/kernels.h"
#include "trainer/model_store.h"
#include "trainer/options.h"

namespace splatbus::trainer {

/// Densifier on the device: chooses the same columns from the same statistics; where the children of a split lie is
/// drawn from the same distribution with other numbers. All on `stream`. One thread. Throws std::runtime_error naming
/// the CUDA error.
class DeviceDensifier {
 public:
  DeviceDensifier(std::uint64_t seed, cudaStream_t stream) : seed_(seed), stream_(stream) {}

  /// The columns to clone or to split, ascending. Waits.
  [[nodiscard]] std::vector<std::uint32_t> choose(const ModelStore& store,
                                                  const raster::cuda::ScreenStatistics& statistics,
                                                  float gradient_threshold);
  /// Clones and splits the columns inside ModelStore::change(), as many as there is room for. Waits. Returns the
  /// columns added at the end.
  ModelStore::Columns densify(ModelStore& store, const std::vector<std::uint32_t>& columns,
                              const DensifyOptions& options);

 private:
  std::uint64_t seed_;
  cudaStream_t stream_;
  device::Buffer<std::uint8_t> chosen_;
  device::Buffer<std::uint32_t> columns_, listed_{1};
  device::Buffer<std::byte> scratch_;
  device::Pinned<std::uint32_t> host_listed_{1};
};

}  // namespace splatbus::trainer

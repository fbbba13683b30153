#pragma once

#include <cuda_runtime_api.h>

#include <cstddef>
#include <cstdint>
#include <optional>

#include "device/buffer.h"
#include "device/pinned.h"
#include "trainer/cuda/step_kernels.h"
#include "trainer/options.h"

namespace splatbus::trainer {

/// find_prunable() on the device: the search is enqueued, and what it found is looked at some steps later. One thread.
/// Throws std::runtime_error naming the CUDA error.
class PruneCheck {
 public:
  explicit PruneCheck(cudaStream_t stream);
  ~PruneCheck();
  PruneCheck(const PruneCheck&) = delete;
  PruneCheck& operator=(const PruneCheck&) = delete;

  /// As the columns are after step `step`; the result holds as long as they stay where they are.
  void search(const cuda::Columns& columns, const PruneOptions& options, std::uint64_t step);
  /// Step of the search whose result was not forgotten yet.
  [[nodiscard]] std::optional<std::uint64_t> since() const { return since_; }

  /// Whether it found enough of `count` Gaussians for a change of structure, which costs every reader: not for a
  /// handful that nobody sees anyway. Waits for the search. When it found too few, the result is forgotten.
  [[nodiscard]] bool wants_removal(std::size_t count);
  [[nodiscard]] bool found_not_finite() const { return host_counts_[0].not_finite > 0; }
  [[nodiscard]] const std::uint8_t* dead() const { return dead_.data(); }
  /// Another search may begin; until it does, dead() stays.
  void forget() { since_.reset(); }

 private:
  cudaStream_t stream_;
  cudaEvent_t done_ = nullptr;
  std::optional<std::uint64_t> since_;
  device::Buffer<std::uint8_t> dead_;
  device::Buffer<cuda::DeadCounts> counts_{1};
  device::Pinned<cuda::DeadCounts> host_counts_{1};
};

}  // namespace splatbus::trainer

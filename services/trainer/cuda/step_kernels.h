#pragma once

#include <cuda_runtime_api.h>

#include <cstdint>

// Kernels over a model's columns between training steps, for CudaOptimizer. Device pointers; planes [channels][stride];
// all enqueued on `stream`. Throw std::runtime_error naming the CUDA error.
namespace splatbus::trainer::cuda {

/// The planes of a model that these kernels read.
struct Columns {
  int count = 0;
  std::int64_t stride = 0;
  float* parameters = nullptr;
  float* average = nullptr;
  const std::uint32_t* flags = nullptr;
  const std::uint64_t* birth = nullptr;  ///< [stride] step at which a column was inserted
  int active_channels = 0;
};

/// TimeAverage::update of the columns [begin, end) after step `step`.
struct AverageOptions {
  int begin = 0, end = 0;
  std::uint64_t step = 0;
  float settled_share = 0;  ///< of an old Gaussian's present value
  float stripes = 0;        ///< steps since these columns were last averaged
};
void launch_average(const Columns& columns, const AverageOptions& options, cudaStream_t stream);

/// What find_dead found.
struct DeadCounts {
  std::uint32_t removed, not_finite;
};
struct FindDeadOptions {
  std::uint64_t step = 0, min_age_steps = 0;
  float min_opacity_logit = 0, max_log_scale = 0;
};
/// trainer::find_dead: marks [count] and counts, which the caller has cleared.
void launch_find_dead(const Columns& columns, const FindDeadOptions& options, std::uint8_t* dead, DeadCounts* counts,
                      cudaStream_t stream);

/// birth[begin..end) = step.
void launch_set_birth(std::uint64_t* birth, int begin, int end, std::uint64_t step, cudaStream_t stream);
/// birth[to[k]] = birth[from[k]], no index in both.
void launch_move_birth(std::uint64_t* birth, const std::uint32_t* from, const std::uint32_t* to, int count,
                       cudaStream_t stream);

}  // namespace splatbus::trainer::cuda

#include "trainer/cuda/prune_check.h"

#include <algorithm>
#include <cmath>

namespace splatbus::trainer {

using device::check;

PruneCheck::PruneCheck(cudaStream_t stream) : stream_(stream) {
  check(cudaEventCreateWithFlags(&done_, cudaEventDisableTiming), "making an event");
}

PruneCheck::~PruneCheck() {
  cudaEventDestroy(done_);
}

void PruneCheck::search(const cuda::Columns& columns, const PruneOptions& options, std::uint64_t step) {
  dead_.resize(static_cast<std::size_t>(std::max<std::int64_t>(columns.stride, 1)));
  counts_.clear(stream_);
  cuda::launch_find_dead(
      columns,
      {.step = step,
       .min_age_steps = options.min_age_steps,
       .min_opacity_logit =
           options.min_opacity > 0 ? std::log(options.min_opacity / (1.0F - options.min_opacity)) : -1e30F,
       .max_log_scale = std::log(options.max_scale_m)},
      dead_.data(), counts_.data(), stream_);
  counts_.download(host_counts_.data(), 1, stream_);
  check(cudaEventRecord(done_, stream_), "recording an event");
  since_ = step;
}

bool PruneCheck::wants_removal(std::size_t count) {
  check(cudaEventSynchronize(done_), "looking for Gaussians to remove");
  const cuda::DeadCounts& counts = host_counts_[0];
  if (counts.not_finite > 0 || std::size_t{counts.removed} * 500 >= count) return true;
  forget();
  return false;
}

}  // namespace splatbus::trainer

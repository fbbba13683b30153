#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "trainer/model_slab.h"

namespace splatbus::trainer {

/// Weight of the present value in an average that was last updated `steps` ago, `age` steps after it began:
/// 1 - decay^steps once the Gaussian is old; before that 4 steps / age, so that the average covers the last quarter of
/// a short life and follows what still moves fast. 1 at the beginning.
[[nodiscard]] float ema_weight(float decay, std::uint64_t steps, std::uint64_t age);

/// Keeps the parameters' average over time. To spread the memory traffic, each step averages one stripe of the columns:
/// every column is averaged once in kStripes steps.
class TimeAverage {
 public:
  static constexpr std::uint64_t kStripes = 8;

  /// After step `step`: updates the stripe whose turn it is, channels below `active_channels`. `created_step[i]` is the
  /// step at which column i was inserted.
  void update(const ModelPlanes& planes, std::size_t count, int active_channels,
              const std::vector<std::uint64_t>& created_step, std::uint64_t step, float decay);

 private:
  std::vector<float> weight_;
};

}  // namespace splatbus::trainer

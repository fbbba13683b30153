#include "trainer/average.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>

namespace splatbus::trainer {

float ema_weight(float decay, std::uint64_t steps, std::uint64_t age) {
  const float settled = 1.0F - std::pow(decay, static_cast<float>(steps));
  if (age == 0) return 1.0F;
  return std::max(settled, std::min(1.0F, 4.0F * static_cast<float>(steps) / static_cast<float>(age)));
}

void TimeAverage::update(const ModelPlanes& planes, std::size_t count, int active_channels,
                         const std::vector<std::uint64_t>& created_step, std::uint64_t step, float decay) {
  const std::uint64_t stripe = step % kStripes;
  const std::size_t begin = count * stripe / kStripes;
  const std::size_t end = count * (stripe + 1) / kStripes;
  weight_.resize(end - begin);
  std::uint64_t last_age = ~std::uint64_t{0};
  float last_weight = 0;
  for (std::size_t i = begin; i < end; ++i) {
    const std::uint64_t age = step - std::min(step, created_step[i]);
    if (age != last_age) {  // neighbours mostly came in one batch
      last_age = age;
      last_weight = ema_weight(decay, kStripes, age);
    }
    weight_[i - begin] = last_weight;
  }
  tbb::parallel_for(0, active_channels, [&](int channel) {
    const std::size_t offset = static_cast<std::size_t>(channel) * planes.capacity + begin;
    const float* const live = planes.parameters + offset;
    float* const average = planes.average + offset;
    const float* const weight = weight_.data();
    for (std::size_t k = 0; k < end - begin; ++k) average[k] += weight[k] * (live[k] - average[k]);
  });
}

}  // namespace splatbus::trainer

#include <cmath>

#include "device/parallel.h"
#include "gaussians/light.h"
#include "trainer/size_limit.h"

namespace splatbus::trainer::kernels {

namespace {

struct LimitSize {
  PagedGaussians gaussians;
  Eyes eyes;
  float log_share;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t item) const {
    const IndexRange range = gaussians.ranges[item / kPageLanes];
    const std::uint32_t lane = item % kPageLanes, i = range.first + lane;
    const bool far_field = range.frame_id == kFarFieldFrame;
    if (lane >= range.count || range.frozen != 0 || (range.frame_id != kWorldFrame && !far_field)) return;
    constexpr int kMean = ParameterLayout::kMean, kScale = ParameterLayout::kLogScale;
    // The far field goes with the camera, in a unit of its own.
    float least_m2 = far_field ? kFarFieldRadius * kFarFieldRadius : 3e38F;
    const float x = *gaussians.memory.value(kMean, i), y = *gaussians.memory.value(kMean + 1, i),
                z = *gaussians.memory.value(kMean + 2, i);
    for (std::uint32_t k = 0; !far_field && k < eyes.count; ++k) {
      const float dx = x - eyes.x_m[k], dy = y - eyes.y_m[k], dz = z - eyes.z_m[k];
      least_m2 = math::smaller(least_m2, dx * dx + dy * dy + dz * dz);
    }
    const float most = log_share + 0.5F * logf(math::larger(least_m2, kNearest_m2));
    for (int axis = 0; axis < 3; ++axis) {
      for (const std::uint32_t channel : {0U, gaussians.channels}) {
        float& log_scale = *gaussians.memory.value(channel + kScale + axis, i);
        if (log_scale > most) log_scale = most;
      }
    }
  }

  static constexpr float kNearest_m2 = 1e-4F;
};

}  // namespace

void limit_sizes(StreamView stream, const PagedGaussians& gaussians, const Eyes& eyes, float share) {
  device::for_each_index(stream, gaussians.range_count * kPageLanes, LimitSize{gaussians, eyes, std::log(share)});
}

}  // namespace splatbus::trainer::kernels

#pragma once

#include <vector>

#include "capture-bridge/input_view.h"
#include "capture-bridge/rig.h"
#include "capture-bridge/round_plan.h"

namespace splatbus::capture_bridge {

/// What a round of input views comes to, in host memory.
struct SampledRound : RoundCounts {
  SampleSet samples;           ///< position and normal in the round's frame (objects where `round_objects` says)
  std::vector<float> depth_m;  ///< all views' pixels, 0 where there is no surface
};

/// Views to samples: validity and footprint, culling across cameras, budget, spacing. `round_objects` are the
/// transforms of the round's frame, to which samples of moving objects are brought. Views in host memory. Uses all TBB
/// workers. Throws std::runtime_error when a round is too large (pixel_views.h).
[[nodiscard]] SampledRound sample_views(Views views, const ObjectTransforms& round_objects,
                                        const SamplingOptions& options);

/// Heights of the middle 96 % of the samples. Everything, when there are none.
[[nodiscard]] ContentHeights content_heights(const SampleSet& samples);

}  // namespace splatbus::capture_bridge

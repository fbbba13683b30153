#pragma once

#include <span>
#include <string>
#include <vector>

#include "capture-bridge/culling.h"
#include "capture-bridge/input_view.h"
#include "capture-bridge/surface.h"

namespace splatbus::capture_bridge {

struct SamplingOptions {
  SurfaceOptions surface{};
  CullOptions culling{};
  std::size_t budget = 60000;  ///< samples a round
  /// How many cameras keep their samples of the same surface, the best ones; 0: as many as the budget has room for.
  int cameras_per_surface = 0;
};

/// What a round of input views comes to.
struct SampledRound {
  SampleSet samples;                        ///< position and normal in the round's frame (objects where `objects` says)
  std::vector<std::vector<float>> depth_m;  ///< a view; [h, w], 0 where there is no surface
  std::vector<DropCounts> dropped;          ///< a view
  int cameras_per_surface = 0;              ///< what the budget had room for
  std::size_t valid = 0;                    ///< samples before culling
  std::size_t culled = 0;                   ///< samples that another camera sees better
  std::size_t thinned = 0;                  ///< samples over the budget
};

/// Views to samples: validity and footprint, culling across cameras, budget, spacing. `round_objects` are the
/// transforms of the round's frame, to which samples of moving objects are brought. Uses all TBB workers.
[[nodiscard]] SampledRound sample_views(Views views, const ObjectTransforms& round_objects,
                                        const SamplingOptions& options);

}  // namespace splatbus::capture_bridge

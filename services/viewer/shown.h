#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "gaussians/light.h"
#include "stream/display_changes.h"
#include "viewer/gl/batch.h"

namespace splatbus::viewer {

/// A state of the scene, and when it was.
struct TimedScene {
  std::shared_ptr<const SceneState> scene;      ///< not null
  std::int64_t capture_ns = 0, arrived_ns = 0;  ///< by the engine's clock, 0: nobody knows; by the viewer's
};

/// What is shown of a replica, since it was asked last: one of `changes` and `batches`, as the painter wants it.
struct Shown {
  stream::DisplayChanges changes;
  std::vector<gl::SharedBatch> batches;
  std::vector<TimedScene> scenes;           ///< the newest last
  std::shared_ptr<const SceneState> scene;  ///< the newest of all; not null
  std::size_t gaussians = 0;                ///< that are shown
  std::uint64_t visibility_version = 0;     ///< newest scene version of any Gaussians' visibility
};

}  // namespace splatbus::viewer

#pragma once

#include <optional>

#include "gaussians/camera.h"
#include "gaussians/light.h"
#include "stream/stream_model.h"

namespace splatbus::streamer {

/// Where a viewer looks, and will look soon.
struct ViewerGaze {
  Camera now, soon;
};

/// Follows a viewer's poses.
class GazeTracker {
 public:
  void add(const Camera& camera, std::int64_t now_ns);
  [[nodiscard]] const std::optional<ViewerGaze>& gaze() const { return gaze_; }

 private:
  std::optional<ViewerGaze> gaze_;
  std::int64_t pose_ns_ = 0;
};

/// How much of a viewer's picture a page may make up: the area in pixels of the sphere about its bounds, at most that
/// of the picture, now or soon. Outside of both, and of an object that is not there, a tenth of what it would be
/// inside. Without a viewer's camera the area is in square centimetres.
[[nodiscard]] float page_weight(const stream::OfferedPage& page, const std::optional<ViewerGaze>& gaze,
                                const ObjectTransforms& objects);

}  // namespace splatbus::streamer

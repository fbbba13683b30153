#pragma once

#include <memory>
#include <opencv2/core.hpp>
#include <optional>

#include "live_scene.h"
#include "raster/rasterizer.h"

namespace splatbus::cli {

/// Renders the averaged model straight from the trainer's memory: what the server would show.
class ServerView {
 public:
  explicit ServerView(int threads);

  /// CV_8UC3 BGR in display space; nullopt when there is no model, or its structure changed while it was drawn.
  [[nodiscard]] std::optional<cv::Mat> render(LiveScene& live, const Camera& camera, const SceneState& scene);

 private:
  std::unique_ptr<raster::Rasterizer> rasterizer_;
  raster::Render render_;
};

}  // namespace splatbus::cli

#pragma once

#include <memory>
#include <opencv2/core.hpp>
#include <optional>

#include "bus/backend.h"
#include "model/live_scene.h"
#include "raster/model_renderer.h"

namespace splatbus::cli {

/// Renders the averaged model straight from the trainer's memory, where that is the backend's: what the server would
/// show.
class ServerView {
 public:
  /// `threads` of the CPU, 0: all cores.
  ServerView(Device backend, int threads);

  /// CV_8UC3 BGR in display space; nullopt when there is no model, or its structure changed while it was drawn.
  [[nodiscard]] std::optional<cv::Mat> render(LiveScene& live, const Camera& camera, const SceneState& scene);

 private:
  const Device memory_;
  std::unique_ptr<raster::ModelRenderer> renderer_;
  raster::Render render_;
};

}  // namespace splatbus::cli

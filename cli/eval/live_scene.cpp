#include "live_scene.h"

#include "metrics/image_io.h"

namespace splatbus::cli {

ServerView::ServerView(Device backend, int threads)
    : memory_(backend), renderer_(raster::make_model_renderer(backend, threads)) {}

std::optional<cv::Mat> ServerView::render(LiveScene& live, const Camera& camera, const SceneState& scene) {
  const PublishedModel* model = live.model(memory_);
  if (model == nullptr || model->average().count == 0) return {};
  renderer_->read_in_place(model->average());
  renderer_->draw(camera, scene, {}, render_);
  if (!model->still_valid()) return {};
  const bool linear = model->average().layout.appearance == Appearance::Transfer;
  return metrics::from_planes(render_.color.data.data(), render_.color.width, render_.color.height, linear);
}

}  // namespace splatbus::cli

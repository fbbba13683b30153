#include "server_view.h"

#include "metrics/image_io.h"

namespace splatbus::cli {

ServerView::ServerView(int threads) : rasterizer_(raster::make_cpu_rasterizer(threads)) {}

std::optional<cv::Mat> ServerView::render(LiveScene& live, const Camera& camera, const SceneState& scene) {
  const PublishedModel* model = live.model();
  if (model == nullptr || model->average().count == 0) return {};
  rasterizer_->render(model->average(), camera, scene, {}, render_);
  if (!model->still_valid()) return {};
  const bool linear = model->average().layout.appearance == Appearance::Transfer;
  return metrics::from_planes(render_.color.data.data(), render_.color.width, render_.color.height, linear);
}

}  // namespace splatbus::cli

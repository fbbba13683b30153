#include <optional>

#include "device/buffer.h"
#include "metrics/image_io.h"
#include "raster/model_renderer.h"
#include "stream/display_gaussians.h"
#include "stream/visibility_history.h"
#include "viewer/painter.h"
#include "viewer/scaled.h"

namespace splatbus::viewer {
namespace {

class RasterPainter final : public Painter {
 public:
  RasterPainter(Device device, int threads)
      : stream_(device), display_(stream_), renderer_(raster::make_model_renderer(device, threads)) {}

  bool take(Shown& shown) override {
    if (shown.changes.empty()) return false;
    turn_back();
    display_.apply(shown.changes);
    visibility_.add(shown.changes);
    shown.changes.clear();
    model_changed_ = true;
    return true;
  }

  cv::Mat draw(const Camera& camera, const SceneState& scene) override {
    const bool linear = render(camera, scene);
    return metrics::from_planes(render_.color.data.data(), camera.width, camera.height, linear);
  }

  cv::Mat alpha(const Camera& camera, const SceneState& scene) override {
    SceneState near = scene;
    near.objects.erase(kFarFieldFrame);
    render(camera, near);
    const raster::Image& alpha = render_.alpha;
    cv::Mat picture;
    cv::Mat(static_cast<int>(alpha.height), static_cast<int>(alpha.width), CV_32FC1,
            const_cast<float*>(alpha.data.data()))
        .convertTo(picture, CV_8U, 255);
    return picture;
  }

  void show(Window& window, const Camera& camera, const SceneState& scene, float) override {
    window.show(draw(scaled(camera, window.settings().resolution), scene));
  }

  std::optional<std::uint64_t> drawn_visibility() const override {
    return turned_ ? std::optional(turned_->version) : std::nullopt;
  }

 private:
  void turn_back() {
    if (turned_) display_.apply(turned_->back);
    turned_.reset();
  }
  /// With what was seen of the lights when the scene was of that version. Returns whether colours are linear.
  bool render(const Camera& camera, const SceneState& scene) {
    if (!turned_ || turned_->version != visibility_.nearest(scene.version)) {
      turn_back();
      turned_ = visibility_.turn_to(scene.version);
      display_.apply(turned_->there);
    }
    const GaussiansView view = display_.view(scene.light.sources);
    // The rows of a probe's lights may be others.
    if (model_changed_ || view.visibility_u8 != drawn_rows_) renderer_->read_in_place(view);
    drawn_rows_ = view.visibility_u8;
    model_changed_ = false;
    renderer_->draw(camera, scene, {}, render_);
    return view.layout.appearance == Appearance::Transfer;
  }

  device::Stream stream_;
  stream::DisplayGaussians display_;
  stream::VisibilityHistory visibility_;
  std::optional<stream::VisibilityHistory::Turn> turned_;  ///< what display_ shows; nullopt: the newest
  std::unique_ptr<raster::ModelRenderer> renderer_;
  raster::Render render_;
  bool model_changed_ = true;  ///< since the renderer read it
  const std::uint8_t* drawn_rows_ = nullptr;
};

}  // namespace

std::unique_ptr<Painter> make_raster_painter(Device device, int threads) {
  return std::make_unique<RasterPainter>(device, threads);
}

}  // namespace splatbus::viewer

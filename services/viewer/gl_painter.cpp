#include <spdlog/spdlog.h>

#include <algorithm>

#include "gl/context.h"
#include "metrics/image_io.h"
#include "viewer/gl/shaders.h"
#include "viewer/gl/stage.h"
#include "viewer/painter.h"

namespace splatbus::viewer {
namespace {

class GlPainter final : public Painter {
 public:
  GlPainter(bool in_window, gl::Draw draw) {
    if (!in_window) context_ = std::make_unique<GlContext>();
    if (context_) spdlog::info("draws through {}", context_->description());
    stage_ = std::make_unique<gl::Stage>(draw);
  }

  bool take(Shown& shown) override {
    bool any = false;
    for (const gl::SharedBatch& batch : shown.batches) {
      begun_ = begun_ || batch->whole;
      if (!begun_) continue;  // it was for a painter that is gone
      any = true;
      for (const float fade : batch->update.fades) faded_s_ = std::max(faded_s_, std::abs(fade) + gl::kFade_s);
      stage_->add(*batch);
    }
    shown.batches.clear();
    return any;
  }

  void advance(std::int64_t shown_ns) override { stage_->advance(shown_ns); }

  cv::Mat draw(const Camera& camera, const SceneState& scene) override {
    const gl::Picture picture = stage_->capture(camera, scene, gl::kSettled_s);
    return metrics::from_rgba(picture.rgba.data(), camera.width, camera.height);
  }

  void show(Window& window, const Camera& camera, const SceneState& scene, float time_s) override {
    stage_->set_resolution(window.settings().resolution);
    stage_->draw(camera, scene, time_s);
    window.swap();
    say_choice();
  }

  bool settles(float time_s) const override { return time_s < faded_s_ || recoloring(); }
  bool recoloring() const override { return stage_->recoloring(); }
  std::optional<std::size_t> drawn() const override { return stage_->count_seen(); }
  std::optional<gl::Bounds> bounds() const override { return stage_->bounds(); }

 private:
  void say_choice() {
    const gl::DrawChoice& choice = stage_->choice();
    if (choice.decided() == said_) return;
    said_ = choice.decided();
    spdlog::info("draws by {}: {:.2f} ms a picture as tiles, {:.2f} as quads",
                 choice.chosen() == gl::Way::Tiles ? "tiles" : "quads", choice.cost_ms(gl::Way::Tiles),
                 choice.cost_ms(gl::Way::Quads));
  }

  std::unique_ptr<GlContext> context_;  // outlives what was made in it
  std::unique_ptr<gl::Stage> stage_;
  bool begun_ = false;
  float faded_s_ = 0;
  unsigned said_ = 0;  // the choice of how to draw
};

}  // namespace

std::unique_ptr<Painter> make_gl_painter(bool in_window, gl::Draw draw) {
  return std::make_unique<GlPainter>(in_window, draw);
}

}  // namespace splatbus::viewer

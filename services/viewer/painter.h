#pragma once

#include <cstdint>
#include <memory>
#include <opencv2/core.hpp>

#include "device/device.h"
#include "gaussians/camera.h"
#include "viewer/gl/draw_choice.h"
#include "viewer/shown.h"
#include "viewer/window.h"

namespace splatbus::viewer {

/// What makes pictures of a replica. One thread. Throws std::runtime_error when its device fails.
class Painter {
 public:
  virtual ~Painter() = default;

  /// Takes what has arrived out of `shown`; true when the picture is another one.
  virtual bool take(Shown& shown) = 0;
  /// What was taken is from now on shown as it was at this time of the engine's clock; 0, as before: as it came. Not
  /// all that was taken can be.
  virtual void advance(std::int64_t /*shown_ns*/) {}
  /// The picture of what was taken, without fades: what is seen of the lights as it was at the scene's version (by a
  /// rasteriser), or as advance() plays it out. CV_8UC3 BGR.
  [[nodiscard]] virtual cv::Mat draw(const Camera& camera, const SceneState& scene) = 0;
  /// CV_8UC1: 255 where Gaussians of what was taken hide all that lies behind them, the far field's left out. Empty
  /// where it is not known.
  [[nodiscard]] virtual cv::Mat alpha(const Camera& /*camera*/, const SceneState& /*scene*/) { return {}; }
  /// A picture in the window, as coarse as its settings say. `time_s`: of the fades, as RowFeed::take has it.
  virtual void show(Window& window, const Camera& camera, const SceneState& scene, float time_s) = 0;
  /// Whether the next show() may be another picture though nothing arrives: rows fade, or recoloring().
  [[nodiscard]] virtual bool settles(float /*time_s*/) const { return false; }
  /// Whether the next draw() may be: other colours are on their way.
  [[nodiscard]] virtual bool recoloring() const { return false; }
  /// Scene version whose visibility the last picture was drawn with; nullopt where it is not known.
  [[nodiscard]] virtual std::optional<std::uint64_t> drawn_visibility() const { return std::nullopt; }
  /// Gaussians that the last picture shows; nullopt where it is not known. Waits for the device.
  [[nodiscard]] virtual std::optional<std::size_t> drawn() const { return std::nullopt; }
  /// Of what there is; nullopt where it is not known.
  [[nodiscard]] virtual std::optional<gl::Bounds> bounds() const { return std::nullopt; }
};

/// By a rasteriser; `threads` on the CPU, 0: all cores.
[[nodiscard]] std::unique_ptr<Painter> make_raster_painter(Device device, int threads);
/// Through OpenGL 4.5: in the context of a window that was opened For::Splats, or, with none, in one of its own without
/// any display.
[[nodiscard]] std::unique_ptr<Painter> make_gl_painter(bool in_window, gl::Draw draw);

}  // namespace splatbus::viewer

#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "gl/objects.h"
#include "viewer/gl/draw_choice.h"
#include "viewer/gl/frame.h"
#include "viewer/gl/frame_timer.h"
#include "viewer/gl/projection.h"
#include "viewer/gl/row_store.h"
#include "viewer/gl/tiles.h"

namespace splatbus::viewer::gl {

/// sRGB, row 0 on top.
struct Picture {
  int width = 0, height = 0;
  std::vector<std::uint8_t> rgba;
};

/// How many pictures were drawn by each way, and how much the last by tiles listed.
struct Drawn {
  std::size_t by_quads = 0, by_tiles = 0;
  std::size_t without_room = 0;  ///< of those by quads: tiles were tried
  std::size_t pairs = 0;
};

/// Draws rows of Gaussians as the CPU rasteriser does: the local affine approximation, 0.3 pixels^2 of low pass with
/// the opacity that it takes away, tangents clamped to 1.3 times the field of view, alpha at most 0.999 and nothing
/// below 1/255; linear light into 16-bit floats, back to front as quads or front to back in tiles, whichever is the
/// faster on the device; then background and the sRGB curve. Of the context that was current when it was made, and has
/// to be in each call: OpenGL 4.5. Throws std::runtime_error when that lacks what is needed, or was lost.
class SplatRenderer {
 public:
  explicit SplatRenderer(Draw draw = Draw::Auto);

  [[nodiscard]] RowStore& rows() { return rows_; }
  /// Pictures are timed from now on, for take_times(), or no more.
  void set_timed(bool timed);
  /// Of pictures that are done and were not taken, in their order.
  [[nodiscard]] std::vector<StepTimes> take_times();

  /// Into a framebuffer of the camera's size: 0 is the window's.
  void draw(const Frame& frame, GLuint framebuffer = 0);
  /// The same picture to memory.
  [[nodiscard]] Picture capture(const Frame& frame);
  /// How pictures were drawn. Waits for the device.
  [[nodiscard]] const Drawn& drawn();
  [[nodiscard]] const DrawChoice& choice() const { return choice_; }
  /// Rows that the last picture shows. Waits for the device.
  [[nodiscard]] std::size_t count_seen() const { return projection_.count_seen(); }

 private:
  /// Takes what has become known of pictures that are done.
  void look_back();
  void draw_splats(const Frame& frame);
  void draw_quads(const Camera& camera);
  void resolve(const Frame& frame, GLuint framebuffer);
  void make_target(std::uint32_t width, std::uint32_t height);

  RowStore rows_;
  Projection projection_;
  DrawChoice choice_;
  std::optional<Tiles> tiles_;  // once they are wanted
  FrameTimer timer_;
  bool timed_ = false;
  std::vector<StepTimes> times_;
  Drawn drawn_;
  GlProgram splats_, resolve_;
  GlVertexArray quads_, nothing_;
  GlBuffer indices_;
  GlTexture target_;
  GlFramebuffer framebuffer_;
  std::uint32_t width_ = 0, height_ = 0;
};

}  // namespace splatbus::viewer::gl

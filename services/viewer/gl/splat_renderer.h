#pragma once

#include <cstdint>
#include <vector>

#include "gl/objects.h"
#include "viewer/gl/frame.h"
#include "viewer/gl/projection.h"
#include "viewer/gl/row_store.h"

namespace splatbus::viewer::gl {

/// sRGB, row 0 on top.
struct Picture {
  int width = 0, height = 0;
  std::vector<std::uint8_t> rgba;
};

/// Draws rows of Gaussians as the CPU rasteriser does: the local affine approximation, 0.3 pixels^2 of low pass with
/// the opacity that it takes away, tangents clamped to 1.3 times the field of view, alpha at most 0.999 and nothing
/// below 1/255; linear light, back to front, into 16-bit floats; then background and the sRGB curve. Of the context
/// that was current when it was made, and has to be in each call: OpenGL 4.5. Throws std::runtime_error when that lacks
/// what is needed, or was lost.
class SplatRenderer {
 public:
  SplatRenderer();

  [[nodiscard]] RowStore& rows() { return rows_; }
  /// Pictures are timed from now on; null: no more.
  void time_with(FrameTimer* timer) { timer_ = timer; }

  /// Into a framebuffer of the camera's size: 0 is the window's.
  void draw(const Frame& frame, GLuint framebuffer = 0);
  /// The same picture to memory.
  [[nodiscard]] Picture capture(const Frame& frame);
  /// Rows that the last picture shows. Waits for the device.
  [[nodiscard]] std::size_t count_seen() const { return projection_.count_seen(); }

 private:
  void draw_splats(const Frame& frame);
  void make_target(std::uint32_t width, std::uint32_t height);

  RowStore rows_;
  Projection projection_;
  FrameTimer* timer_ = nullptr;
  GlProgram splats_, resolve_;
  GlVertexArray quads_, nothing_;
  GlBuffer indices_;
  GlTexture target_;
  GlFramebuffer framebuffer_;
  std::uint32_t width_ = 0, height_ = 0;
};

}  // namespace splatbus::viewer::gl

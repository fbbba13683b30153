#pragma once

#include <cstdint>
#include <glm/glm.hpp>
#include <span>
#include <vector>

#include "gaussians/camera.h"
#include "gaussians/depth_order.h"
#include "gl/objects.h"
#include "viewer/gl/row_store.h"

namespace splatbus::viewer::gl {

/// world_from_object, row-major [3][4]; all zero hides what is in it.
using Transform = DepthOrder::Transform;

/// What one picture shows of the rows.
struct Frame {
  Camera camera;
  std::vector<Transform> transforms;  ///< by the index that records have
  std::uint32_t far_field = 0;  ///< index of what goes with the eye, its transform for an eye in the origin; 0: none
  glm::vec3 background{0};      ///< linear
  bool display_space = false;   ///< colors are blended under the sRGB curve
  bool antialias = true;        ///< what is smaller than a pixel becomes as much fainter as it is made larger
  float time_s = kSettled_s;    ///< by the clock of RowUpdate::fades
};

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
  /// Which rows there are, back to front.
  void set_order(std::span<const std::uint32_t> order);
  [[nodiscard]] std::size_t count() const { return count_; }

  /// Into a framebuffer of the camera's size: 0 is the window's.
  void draw(const Frame& frame, GLuint framebuffer = 0);
  /// The same picture to memory.
  [[nodiscard]] Picture capture(const Frame& frame);

 private:
  void draw_splats(const Frame& frame);
  void upload_objects(const Frame& frame);
  void make_target(std::uint32_t width, std::uint32_t height);

  RowStore rows_;
  GlProgram splats_, resolve_;
  GlVertexArray quads_, nothing_;
  GlBuffer indices_, order_, objects_;
  GlTexture target_;
  GlFramebuffer framebuffer_;
  std::uint32_t width_ = 0, height_ = 0;
  std::size_t count_ = 0, order_capacity_ = 0;
  std::vector<float> camera_from_objects_;
};

}  // namespace splatbus::viewer::gl

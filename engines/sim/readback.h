#pragma once

#include <cstddef>
#include <cstdint>

#include "gl/objects.h"
#include "sdk/splatbus_engine.h"

namespace splatbus::sim {

/// A picture in an attachment of a framebuffer, rows from the top, and how glReadPixels shall hand it out.
struct DrawnPicture {
  splatbus_buffer buffer = SPLATBUS_BUFFER_COLOR;
  GLuint framebuffer = 0;
  GLenum attachment = 0, format = 0, type = 0;
  std::uint32_t width = 0, height = 0;
  std::size_t bytes = 0;  ///< packed rows
};

/// Reads a picture: into `pixels`, or, while a buffer is bound to GL_PIXEL_PACK_BUFFER, into that one at the offset
/// that `pixels` then is.
inline void read_pixels(const DrawnPicture& drawn, void* pixels) {
  glBindFramebuffer(GL_READ_FRAMEBUFFER, drawn.framebuffer);
  glNamedFramebufferReadBuffer(drawn.framebuffer, drawn.attachment);
  glReadPixels(0, 0, static_cast<GLsizei>(drawn.width), static_cast<GLsizei>(drawn.height), drawn.format, drawn.type,
               pixels);
}

/// Takes what a renderer draws out of OpenGL. On the thread where the context is current.
class Readback {
 public:
  virtual ~Readback() = default;
  /// A camera's pictures follow, so many bytes together.
  virtual void begin(std::uint32_t width, std::uint32_t height, std::size_t bytes) = 0;
  /// Each buffer once. Throws std::runtime_error.
  virtual void take(const DrawnPicture& drawn) = 0;
};

}  // namespace splatbus::sim

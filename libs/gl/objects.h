#pragma once

#include <epoxy/gl.h>

#include <utility>

namespace splatbus {

/// Owns one OpenGL name. The context that made it must be current when it dies.
template <void (*Delete)(GLuint)>
class GlName {
 public:
  GlName() = default;
  explicit GlName(GLuint name) : name_(name) {}
  ~GlName() { reset(); }
  GlName(GlName&& other) noexcept : name_(std::exchange(other.name_, 0)) {}
  GlName& operator=(GlName&& other) noexcept {
    if (this != &other) {
      reset();
      name_ = std::exchange(other.name_, 0);
    }
    return *this;
  }
  GlName(const GlName&) = delete;
  GlName& operator=(const GlName&) = delete;

  [[nodiscard]] GLuint get() const { return name_; }
  explicit operator bool() const { return name_ != 0; }

 private:
  void reset() {
    if (name_ != 0) Delete(name_);
    name_ = 0;
  }
  GLuint name_ = 0;
};

inline void delete_texture(GLuint name) {
  glDeleteTextures(1, &name);
}
inline void delete_buffer(GLuint name) {
  glDeleteBuffers(1, &name);
}
inline void delete_vertex_array(GLuint name) {
  glDeleteVertexArrays(1, &name);
}
inline void delete_framebuffer(GLuint name) {
  glDeleteFramebuffers(1, &name);
}
inline void delete_program(GLuint name) {
  glDeleteProgram(name);
}

inline void delete_query(GLuint name) {
  glDeleteQueries(1, &name);
}

using GlTexture = GlName<delete_texture>;
using GlBuffer = GlName<delete_buffer>;
using GlVertexArray = GlName<delete_vertex_array>;
using GlFramebuffer = GlName<delete_framebuffer>;
using GlProgram = GlName<delete_program>;
using GlQuery = GlName<delete_query>;

[[nodiscard]] inline GlTexture make_texture(GLenum target) {
  GLuint name = 0;
  glCreateTextures(target, 1, &name);
  return GlTexture(name);
}

[[nodiscard]] inline GlBuffer make_buffer() {
  GLuint name = 0;
  glCreateBuffers(1, &name);
  return GlBuffer(name);
}

[[nodiscard]] inline GlQuery make_query(GLenum target) {
  GLuint name = 0;
  glCreateQueries(target, 1, &name);
  return GlQuery(name);
}

[[nodiscard]] inline GlVertexArray make_vertex_array() {
  GLuint name = 0;
  glCreateVertexArrays(1, &name);
  return GlVertexArray(name);
}

[[nodiscard]] inline GlFramebuffer make_framebuffer() {
  GLuint name = 0;
  glCreateFramebuffers(1, &name);
  return GlFramebuffer(name);
}

}  // namespace splatbus

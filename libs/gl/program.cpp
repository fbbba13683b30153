#include "gl/program.h"

#include <fmt/format.h>

#include <stdexcept>
#include <string>

#include "gl/context.h"

namespace splatbus {
namespace {

class Shader {
 public:
  Shader(GLenum kind, std::string_view text) : name_(glCreateShader(kind)) {
    const char* data = text.data();
    const auto length = static_cast<GLint>(text.size());
    glShaderSource(name_, 1, &data, &length);
    glCompileShader(name_);
    GLint compiled = GL_FALSE;
    glGetShaderiv(name_, GL_COMPILE_STATUS, &compiled);
    if (compiled == GL_TRUE) return;
    std::string log(4096, '\0');
    GLsizei said = 0;
    glGetShaderInfoLog(name_, static_cast<GLsizei>(log.size()), &said, log.data());
    log.resize(static_cast<std::size_t>(said));
    glDeleteShader(name_);
    require_context();
    throw std::runtime_error(fmt::format("a shader does not compile: {}", log));
  }
  ~Shader() { glDeleteShader(name_); }
  Shader(const Shader&) = delete;
  Shader& operator=(const Shader&) = delete;
  [[nodiscard]] GLuint get() const { return name_; }

 private:
  GLuint name_;
};

void link(GLuint program) {
  glLinkProgram(program);
  GLint linked = GL_FALSE;
  glGetProgramiv(program, GL_LINK_STATUS, &linked);
  if (linked == GL_TRUE) return;
  std::string log(4096, '\0');
  GLsizei said = 0;
  glGetProgramInfoLog(program, static_cast<GLsizei>(log.size()), &said, log.data());
  log.resize(static_cast<std::size_t>(said));
  require_context();
  throw std::runtime_error(fmt::format("a program does not link: {}", log));
}

}  // namespace

GlProgram make_program(std::string_view vertex_text, std::string_view fragment_text) {
  const Shader vertex(GL_VERTEX_SHADER, vertex_text), fragment(GL_FRAGMENT_SHADER, fragment_text);
  GlProgram program(glCreateProgram());
  glAttachShader(program.get(), vertex.get());
  glAttachShader(program.get(), fragment.get());
  link(program.get());
  return program;
}

GlProgram make_compute_program(std::string_view text) {
  const Shader shader(GL_COMPUTE_SHADER, text);
  GlProgram program(glCreateProgram());
  glAttachShader(program.get(), shader.get());
  link(program.get());
  return program;
}

}  // namespace splatbus

#include "sim/shaders.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <initializer_list>
#include <numbers>
#include <stdexcept>

#include "sim/shader_text.h"

namespace splatbus::sim {
namespace {

constexpr const char* kVersion = "#version 450 core\n";

std::string info_log(GLuint name, bool program) {
  std::string text(4096, '\0');
  GLsizei length = 0;
  if (program) {
    glGetProgramInfoLog(name, static_cast<GLsizei>(text.size()), &length, text.data());
  } else {
    glGetShaderInfoLog(name, static_cast<GLsizei>(text.size()), &length, text.data());
  }
  text.resize(static_cast<std::size_t>(length));
  return text;
}

struct Stage {
  GLenum kind;
  const char* source;  ///< null: there is none
};

GlProgram link(const std::string& defines, std::initializer_list<Stage> stages) {
  GlProgram program(glCreateProgram());
  for (const auto& [stage, source] : stages) {
    if (source == nullptr) continue;
    const std::string text = kVersion + defines + source;
    const char* pointer = text.c_str();
    const GLuint shader = glCreateShader(stage);
    glShaderSource(shader, 1, &pointer, nullptr);
    glCompileShader(shader);
    GLint compiled = GL_FALSE;
    glGetShaderiv(shader, GL_COMPILE_STATUS, &compiled);
    const std::string log = compiled == GL_TRUE ? std::string() : info_log(shader, false);
    glAttachShader(program.get(), shader);
    glDeleteShader(shader);
    if (compiled != GL_TRUE) throw std::runtime_error("a shader does not compile: " + log);
  }
  glLinkProgram(program.get());
  GLint linked = GL_FALSE;
  glGetProgramiv(program.get(), GL_LINK_STATUS, &linked);
  if (linked != GL_TRUE) throw std::runtime_error("a shader program does not link: " + info_log(program.get(), true));
  return program;
}

/// Points of the unit disc, shared out evenly: `taps` of them for each supersample, and the turn (cosine, sine, scaled)
/// that each supersample gives them.
std::string disc_tables(int supersample) {
  constexpr int kTapsAPixel = 16;
  constexpr int kLeastTaps = 4;
  const int turns = supersample * supersample;
  const int taps = std::max(kTapsAPixel / turns, kLeastTaps);
  std::string points;
  for (int i = 0; i < taps; ++i) {
    const double angle = 2 * std::numbers::pi * i / taps;
    const double radius = std::sqrt((i * 5 % taps + 0.5) / taps);
    points +=
        fmt::format("{}vec2({:.6f}, {:.6f})", i == 0 ? "" : ", ", radius * std::cos(angle), radius * std::sin(angle));
  }
  std::string rotations;
  for (int i = 0; i < turns; ++i) {
    const double angle = 2 * std::numbers::pi * i / (taps * turns);
    rotations += fmt::format("{}vec2({:.6f}, {:.6f})", i == 0 ? "" : ", ", std::cos(angle), std::sin(angle));
  }
  return fmt::format(
      "#define SUPERSAMPLE {}\n#define TAPS {}\nconst vec2 kTaps[{}] = vec2[]({});\nconst vec2 kTurns[{}] = "
      "vec2[]({});\n",
      supersample, taps, taps, points, turns, rotations);
}

}  // namespace

GlProgram build_program(const ShaderVariant& variant) {
  std::string defines;
  const bool shade = variant.kind == ShaderVariant::Kind::Shade;
  if (shade || variant.holes) defines += "#define TEXTURED\n";
  if (variant.holes) defines += "#define HOLES\n";
  if (variant.kind == ShaderVariant::Kind::Geometry) defines += "#define GEOMETRY\n";
  const bool lit = shade && variant.lit && !variant.emissive;
  if (shade && variant.lit) defines += "#define OUT_LIT 0\n";
  if (lit) defines += "#define LIT\n" + disc_tables(variant.supersample);
  if (lit && variant.cascades) defines += fmt::format("#define CASCADES {}\n", kCascades);
  if (lit && (variant.cascades || variant.sources)) {
    constexpr float kLeastCosine = 0.16F;
    defines += fmt::format("#define LIFT_TEXELS {:.3f}\n#define LEAST_COSINE {:.3f}\n", kLiftTexels, kLeastCosine);
  }
  if (lit && variant.sources) {
    defines += fmt::format("#define SOURCES {}\n", SPLATBUS_MAX_LIGHTS);
  }
  if (shade && variant.albedo) defines += "#define ALBEDO\n#define OUT_ALBEDO 1\n";
  const bool fragment = variant.kind != ShaderVariant::Kind::Depth || variant.holes;
  return link(defines, {{GL_VERTEX_SHADER, kVertexShader}, {GL_FRAGMENT_SHADER, fragment ? kFragmentShader : nullptr}});
}

GlProgram build_program(const char* vertex_text, const char* fragment_text) {
  return link({}, {{GL_VERTEX_SHADER, vertex_text}, {GL_FRAGMENT_SHADER, fragment_text}});
}

GlProgram build_compute_program(const char* text) {
  return link({}, {{GL_COMPUTE_SHADER, text}});
}

GlProgram build_resolve_program(int supersample, int samples, bool lit, bool albedo) {
  const std::string defines = fmt::format("#define SUPERSAMPLE {}\n#define SAMPLES {}\n{}{}", supersample, samples,
                                          lit ? "#define LIT\n" : "", albedo ? "#define ALBEDO\n" : "");
  return link(defines, {{GL_VERTEX_SHADER, kResolveVertexShader}, {GL_FRAGMENT_SHADER, kResolveFragmentShader}});
}

}  // namespace splatbus::sim

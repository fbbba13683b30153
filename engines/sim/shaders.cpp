#include "sim/shaders.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <stdexcept>

namespace splatbus::sim {
namespace {

constexpr const char* kVersion = "#version 450 core\n";

constexpr const char* kVertexShader = R"(
layout(location = 0) in vec3 a_position;
layout(location = 1) in vec3 a_normal;
layout(location = 2) in vec2 a_uv;
layout(location = 0) uniform mat4 world_from_object;
layout(location = 1) uniform mat3 normal_matrix;
layout(location = 2) uniform mat4 clip_from_world;
layout(location = 3) uniform vec4 view_z;
#ifdef LIT
layout(location = 4) uniform mat4 shadow_from_world;
layout(location = 11) uniform vec4 shadow_filter;
out vec3 v_shadow;
#endif
#ifdef TEXTURED
out vec2 v_uv;
#endif
#ifdef GEOMETRY
out vec4 v_world_and_depth;
#endif
#if defined(LIT) || defined(GEOMETRY)
out vec3 v_normal;
#endif

void main() {
  vec4 world = world_from_object * vec4(a_position, 1);
  gl_Position = clip_from_world * world;
#ifdef TEXTURED
  v_uv = a_uv;
#endif
#if defined(LIT) || defined(GEOMETRY)
  v_normal = normal_matrix * a_normal;
#endif
#ifdef GEOMETRY
  v_world_and_depth = vec4(world.xyz, dot(view_z, world));
#endif
#ifdef LIT
  vec4 lifted = vec4(world.xyz + shadow_filter.w * normalize(v_normal), 1);
  v_shadow = (shadow_from_world * lifted).xyz;
#endif
}
)";

constexpr const char* kFragmentShader = R"(
#ifdef TEXTURED
in vec2 v_uv;
layout(binding = 0) uniform sampler2D base_texture;
layout(location = 6) uniform vec3 base_color;
layout(location = 7) uniform float alpha_cutoff;
#endif
#if defined(LIT) || defined(GEOMETRY)
in vec3 v_normal;
#endif

#ifdef LIT
in vec3 v_shadow;
layout(binding = 1) uniform sampler2DShadow shadow_map;
layout(location = 8) uniform vec3 sun_direction;
layout(location = 9) uniform vec3 sun_over_pi;
layout(location = 10) uniform mat3 shadow_normal;
layout(location = 11) uniform vec4 shadow_filter;
layout(location = 12) uniform vec3 ambient[9];
layout(location = OUT_LIT) out vec4 out_lit;

// Irradiance over pi of degree-2 incident radiance (Ramamoorthi and Hanrahan 2001); the factors are in the uniform.
vec3 ambient_reflected(vec3 n) {
  return ambient[0] - ambient[1] * n.y + ambient[2] * n.z - ambient[3] * n.x
       + ambient[4] * (n.x * n.y) - ambient[5] * (n.y * n.z) + ambient[6] * (2 * n.z * n.z - n.x * n.x - n.y * n.y)
       - ambient[7] * (n.x * n.z) + ambient[8] * (n.x * n.x - n.y * n.y);
}

// Percentage-closer filtering on a disc. Every tap is compared with the receiver's own plane, so that a slanted surface
// does not shade itself; a pixel's supersamples take turns of the disc.
float sun_visibility(vec3 n) {
  vec3 plane = shadow_normal * n;
  vec2 slope = clamp(-plane.xy / min(plane.z, -1e-6), -shadow_filter.z, shadow_filter.z);
  ivec2 pixel = ivec2(mod(gl_FragCoord.xy, SUPERSAMPLE));  // integer division is slow on a CPU
  vec2 turn = kTurns[pixel.y * SUPERSAMPLE + pixel.x];
  float sum = 0;
  for (int i = 0; i < TAPS; ++i) {
    vec2 offset = shadow_filter.xy * vec2(kTaps[i].x * turn.x - kTaps[i].y * turn.y,
                                          kTaps[i].x * turn.y + kTaps[i].y * turn.x);
    sum += textureLod(shadow_map, v_shadow + vec3(offset, dot(offset, slope)), 0);
  }
  return sum / float(TAPS);
}
#endif

#ifdef ALBEDO
layout(location = OUT_ALBEDO) out vec4 out_albedo;
#endif

#ifdef GEOMETRY
in vec4 v_world_and_depth;
layout(location = 5) uniform uint object_id;
layout(location = 0) out vec4 out_position;
layout(location = 1) out vec4 out_normal;
layout(location = 2) out float out_depth;
layout(location = 3) out uint out_object_id;
#endif

void main() {
#ifdef TEXTURED
  vec4 texel = texture(base_texture, v_uv);
#ifdef HOLES
  if (texel.a < alpha_cutoff) discard;
#endif
  vec3 base = texel.rgb * base_color;
#endif
#if defined(LIT) || defined(GEOMETRY)
  vec3 n = normalize(gl_FrontFacing ? v_normal : -v_normal);
#endif
#ifdef LIT
  vec3 light = ambient_reflected(n);
  float cosine = dot(n, sun_direction);
  if (cosine > 0) light += sun_over_pi * (cosine * sun_visibility(n));
  out_lit = vec4(base * light, 1);
#endif
#ifdef ALBEDO
  out_albedo = vec4(base, 1);
#endif
#ifdef GEOMETRY
  out_position = vec4(v_world_and_depth.xyz, 1);
  out_normal = vec4(n, 0);
  out_depth = v_world_and_depth.w;
  out_object_id = object_id;
#endif
}
)";

constexpr const char* kResolveVertexShader = R"(
void main() {
  gl_Position = vec4(vec2((gl_VertexID << 1) & 2, gl_VertexID & 2) * 2 - 1, 0, 1);
}
)";

constexpr const char* kResolveFragmentShader = R"(
layout(binding = 0) uniform sampler2DMS lit;
layout(binding = 1) uniform sampler2DMS albedo;
layout(location = 0) out vec4 out_first;
layout(location = 1) out vec4 out_second;

vec4 average(sampler2DMS source) {
  ivec2 corner = ivec2(gl_FragCoord.xy) * SUPERSAMPLE;
  vec4 sum = vec4(0);
  for (int y = 0; y < SUPERSAMPLE; ++y)
    for (int x = 0; x < SUPERSAMPLE; ++x)
      for (int s = 0; s < SAMPLES; ++s) sum += texelFetch(source, corner + ivec2(x, y), s);
  return sum / float(SUPERSAMPLE * SUPERSAMPLE * SAMPLES);
}

vec4 encoded(vec4 linear) {
  vec3 c = clamp(linear.rgb, 0, 1);
  return vec4(mix(12.92 * c, 1.055 * pow(c, vec3(1 / 2.4)) - 0.055, greaterThan(c, vec3(0.0031308))), linear.a);
}

void main() {
#ifdef LIT
  out_first = encoded(average(lit));
#endif
#ifdef ALBEDO
  out_second = encoded(average(albedo));
#endif
}
)";

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

GlProgram link(const std::string& defines, const char* vertex_source, const char* fragment_source) {
  GlProgram program(glCreateProgram());
  for (const auto& [stage, source] :
       {std::pair{GL_VERTEX_SHADER, vertex_source}, {GL_FRAGMENT_SHADER, fragment_source}}) {
    if (source == nullptr) continue;
    const std::string text = kVersion + defines + source;
    const char* pointer = text.c_str();
    const GLuint shader = glCreateShader(static_cast<GLenum>(stage));
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
  if (shade && variant.lit) defines += "#define LIT\n#define OUT_LIT 0\n" + disc_tables(variant.supersample);
  if (shade && variant.albedo) defines += "#define ALBEDO\n#define OUT_ALBEDO 1\n";
  const bool fragment = variant.kind != ShaderVariant::Kind::Depth || variant.holes;
  return link(defines, kVertexShader, fragment ? kFragmentShader : nullptr);
}

GlProgram build_resolve_program(int supersample, int samples, bool lit, bool albedo) {
  const std::string defines = fmt::format("#define SUPERSAMPLE {}\n#define SAMPLES {}\n{}{}", supersample, samples,
                                          lit ? "#define LIT\n" : "", albedo ? "#define ALBEDO\n" : "");
  return link(defines, kResolveVertexShader, kResolveFragmentShader);
}

}  // namespace splatbus::sim

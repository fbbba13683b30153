#include "sim/sky.h"

#include <glm/gtc/type_ptr.hpp>

#include "sim/projection.h"
#include "sim/shaders.h"

namespace splatbus::sim {
namespace {

enum SkyLocation : GLint { kWorldFromCamera = 0, kRayFromClip = 1, kBackground = 2 };

const char* const kVertexText = R"(
layout(location = 0) uniform mat3 world_from_camera;
layout(location = 1) uniform vec4 ray_from_clip;  // scale, then offset, of x and y at 1 m
out vec3 v_direction;
void main() {
  vec2 at = vec2((gl_VertexID << 1) & 2, gl_VertexID & 2) * 2 - 1;
  gl_Position = vec4(at, 0, 1);
  v_direction = world_from_camera * vec3(at * ray_from_clip.xy + ray_from_clip.zw, 1);
}
)";

// Value noise on a lattice, summed over octaves (Perlin 1985).
const char* const kFragmentText = R"(
layout(location = 2) uniform vec3 background;
in vec3 v_direction;
layout(location = 0) out vec4 out_lit;

float at_lattice(vec2 p) {
  uvec2 q = uvec2(ivec2(p)) * uvec2(1597334673u, 3812015801u);
  uint n = (q.x ^ q.y) * 1597334673u;
  n ^= n >> 15;
  return float(n * 2246822519u >> 8) / 16777216.0;
}
float noise(vec2 p) {
  vec2 cell = floor(p), t = smoothstep(0.0, 1.0, p - cell);
  return mix(mix(at_lattice(cell), at_lattice(cell + vec2(1, 0)), t.x),
             mix(at_lattice(cell + vec2(0, 1)), at_lattice(cell + vec2(1, 1)), t.x), t.y);
}
float octaves(vec2 p) {
  return 0.5 * noise(p) + 0.25 * noise(2.03 * p + 17) + 0.125 * noise(4.1 * p + 5) + 0.0625 * noise(8.3 * p + 29);
}

void main() {
  vec3 d = normalize(v_direction);
  float elevation = d.y;
  vec2 level = normalize(d.xz + vec2(1e-6, 0));
  // On a circle, so that the hills close all around.
  float hills = 0.04 + 0.2 * octaves(4 * level + 40) * noise(2 * level + 90);
  vec3 zenith = vec3(0.55, 0.8, 1.15), haze = vec3(1.1, 1.08, 1.05);
  vec3 shade = mix(haze, zenith, sqrt(clamp(elevation, 0, 1)));
  float cover = smoothstep(0.42, 0.62, octaves(1.6 * d.xz / (max(elevation, 0) + 0.25) + 60));
  shade = mix(shade, vec3(1.45, 1.42, 1.4), 0.85 * cover * smoothstep(0.02, 0.2, elevation));
  float height = smoothstep(hills + 0.012, hills, elevation);
  vec3 slope = mix(vec3(0.32, 0.42, 0.38), vec3(0.5, 0.55, 0.6), octaves(20 * level + vec2(0, 30 * elevation) + 80));
  out_lit = vec4(background * mix(shade, slope, height), 0);
}
)";

}  // namespace

void Sky::draw(const splatbus_camera& camera, const splatbus_light& light) {
  if (!program_) {
    program_ = build_program(kVertexText, kFragmentText);
    no_vertices_ = make_vertex_array();
  }
  const glm::mat3 world_from_camera = glm::transpose(glm::mat3(camera_from_world(camera)));
  const float half_width = 0.5F * static_cast<float>(camera.width),
              half_height = 0.5F * static_cast<float>(camera.height);
  glProgramUniformMatrix3fv(program_.get(), kWorldFromCamera, 1, GL_FALSE, glm::value_ptr(world_from_camera));
  glProgramUniform4f(program_.get(), kRayFromClip, half_width / camera.fx, half_height / camera.fy,
                     (half_width - camera.cx) / camera.fx, (half_height - camera.cy) / camera.fy);
  glProgramUniform3fv(program_.get(), kBackground, 1, light.background);
  glDisable(GL_DEPTH_TEST);
  glDepthMask(GL_FALSE);
  glDisable(GL_CULL_FACE);
  glUseProgram(program_.get());
  glBindVertexArray(no_vertices_.get());
  glDrawArrays(GL_TRIANGLES, 0, 3);
  glDepthMask(GL_TRUE);
  glEnable(GL_DEPTH_TEST);
}

}  // namespace splatbus::sim

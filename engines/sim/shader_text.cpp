#include "sim/shader_text.h"

namespace splatbus::sim {

const char* const kVertexShader = R"(
layout(location = 0) in vec3 a_position;
layout(location = 1) in vec3 a_normal;
layout(location = 2) in vec2 a_uv;
layout(location = 0) uniform mat4 world_from_object;
layout(location = 1) uniform mat3 normal_matrix;
layout(location = 2) uniform mat4 clip_from_world;
layout(location = 3) uniform vec4 view_z;
#ifdef LIT
#ifndef CASCADES
layout(location = 4) uniform mat4 shadow_from_world;
layout(location = 11) uniform vec4 shadow_filter;
out vec3 v_shadow;
#endif
#if defined(CASCADES) || defined(SOURCES)
out vec3 v_world;
#endif
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
#if defined(LIT) && !defined(CASCADES)
  vec4 lifted = vec4(world.xyz + shadow_filter.w * normalize(v_normal), 1);
  v_shadow = (shadow_from_world * lifted).xyz;
#endif
#if defined(CASCADES) || defined(SOURCES)
  v_world = world.xyz;
#endif
}
)";

const char* const kFragmentShader = R"(
#ifdef TEXTURED
in vec2 v_uv;
layout(binding = 0) uniform sampler2D base_texture;
layout(location = 6) uniform vec3 base_color;
layout(location = 7) uniform float alpha_cutoff;
#endif
#if defined(LIT) || defined(GEOMETRY)
in vec3 v_normal;
#endif

#ifdef OUT_LIT
layout(location = OUT_LIT) out vec4 out_lit;
#endif

#ifdef LIT
layout(location = 8) uniform vec3 sun_direction;
layout(location = 9) uniform vec3 sun_over_pi;
layout(location = 12) uniform vec3 ambient[9];

// Irradiance over pi of degree-2 incident radiance (Ramamoorthi and Hanrahan 2001); the factors are in the uniform.
vec3 ambient_reflected(vec3 n) {
  return ambient[0] - ambient[1] * n.y + ambient[2] * n.z - ambient[3] * n.x
       + ambient[4] * (n.x * n.y) - ambient[5] * (n.y * n.z) + ambient[6] * (2 * n.z * n.z - n.x * n.x - n.y * n.y)
       - ambient[7] * (n.x * n.z) + ambient[8] * (n.x * n.x - n.y * n.y);
}

// Shadows are percentage-closer filtered on a disc. Every tap is compared with the receiver's own plane, so that a
// slanted surface does not shade itself; a pixel's supersamples take turns of the disc.
vec2 disc_turn() {
  ivec2 pixel = ivec2(mod(gl_FragCoord.xy, SUPERSAMPLE));  // integer division is slow on a CPU
  return kTurns[pixel.y * SUPERSAMPLE + pixel.x];
}
vec2 disc_tap(int i, vec2 turn) {
  return vec2(kTaps[i].x * turn.x - kTaps[i].y * turn.y, kTaps[i].x * turn.y + kTaps[i].y * turn.x);
}

#if defined(CASCADES) || defined(SOURCES)
in vec3 v_world;
layout(location = 21) uniform float softness_m;

// A map's coordinates u, v and depth, times w.
vec4 in_map(mat4 map_from_world, vec3 world) {
  return map_from_world * vec4(world, 1);
}

// The share of the taps about `world`, on a surface with normal n, that the light of a map reaches. The map has
// `uv_a_metre` at w = 1, whose w is the distance along its axis, or 1 throughout where it is orthographic.
float reached(sampler2DArrayShadow maps, float layer, mat4 map_from_world, float uv_a_metre, vec3 world, vec3 n,
              vec3 to_light) {
  float texel = 1 / float(textureSize(maps, 0).x);
  vec4 at = in_map(map_from_world, world);
  float lift_m = LIFT_TEXELS * texel * at.w / uv_a_metre;
  at += map_from_world * vec4(lift_m * n, 0);
  vec3 uvz = at.xyz / at.w;
  // Edge on, a plane's depth would change without bound within the filter.
  vec3 facing = normalize(n + max(0, LEAST_COSINE - dot(n, to_light)) * to_light);
  vec3 first = normalize(cross(facing, abs(facing.y) < 0.9 ? vec3(0, 1, 0) : vec3(1, 0, 0)));
  vec4 d_first = map_from_world * vec4(first, 0);
  vec4 d_second = map_from_world * vec4(cross(facing, first), 0);
  vec3 plane = cross(d_first.xyz - uvz * d_first.w, d_second.xyz - uvz * d_second.w);
  vec2 slope = -plane.xy / plane.z;
  float radius = max(softness_m * uv_a_metre / at.w, texel);
  vec2 turn = disc_turn();
  float sum = 0;
  for (int i = 0; i < TAPS; ++i) {
    vec2 offset = radius * disc_tap(i, turn);
    sum += texture(maps, vec4(uvz.xy + offset, layer, min(uvz.z + dot(offset, slope), 1)));
  }
  return sum / float(TAPS);
}
#endif

#ifdef CASCADES
layout(binding = 1) uniform sampler2DArrayShadow cascade_maps;
layout(location = 22) uniform mat4 cascade_from_world[CASCADES];
layout(location = 22 + CASCADES) uniform float cascade_uv_a_metre[CASCADES];

float sun_visibility(vec3 n) {
  int cascade = 0;
  for (; cascade + 1 < CASCADES; ++cascade) {
    vec2 uv = abs(in_map(cascade_from_world[cascade], v_world).xy - 0.5);
    if (max(uv.x, uv.y) < 0.48) break;
  }
  return reached(cascade_maps, float(cascade), cascade_from_world[cascade], cascade_uv_a_metre[cascade], v_world, n,
                 sun_direction);
}
#else
in vec3 v_shadow;
layout(binding = 1) uniform sampler2DShadow shadow_map;
layout(location = 10) uniform mat3 shadow_normal;
layout(location = 11) uniform vec4 shadow_filter;

float sun_visibility(vec3 n) {
  vec3 plane = shadow_normal * n;
  vec2 slope = clamp(-plane.xy / min(plane.z, -1e-6), -shadow_filter.z, shadow_filter.z);
  vec2 turn = disc_turn();
  float sum = 0;
  for (int i = 0; i < TAPS; ++i) {
    vec2 offset = shadow_filter.xy * disc_tap(i, turn);
    sum += textureLod(shadow_map, v_shadow + vec3(offset, dot(offset, slope)), 0);
  }
  return sum / float(TAPS);
}
#endif

#ifdef SOURCES
struct Source {
  vec4 position_range;
  vec4 direction_kind;      // splatbus_light_kind
  vec4 intensity_map;       // over pi; its first matrix, below 0: it casts no shadow
  vec4 cone_uv_layer;       // cosine of the outer angle, 1 / (inner - outer); uv a metre; its first layer
};
layout(std140, binding = 0) uniform Sources {
  Source sources[SOURCES];
  mat4 map_from_world[SOURCE_MAPS];
  int source_count;
};
layout(binding = 2) uniform sampler2DArrayShadow local_maps;
layout(binding = 3) uniform sampler2DArrayShadow directional_maps;

int cube_face(vec3 way) {
  vec3 size = abs(way);
  if (size.x >= max(size.y, size.z)) return way.x > 0 ? 0 : 1;
  if (size.y >= size.z) return way.y > 0 ? 2 : 3;
  return way.z > 0 ? 4 : 5;
}

// schemas/common.fbs, LightSource.
vec3 from_source(Source source, vec3 n) {
  int kind = int(source.direction_kind.w);
  vec3 to_light = source.direction_kind.xyz;
  float factor = 1;
  int face = 0;
  if (kind != 0) {
    vec3 way = source.position_range.xyz - v_world;
    float distance_m = max(length(way), 0.01);
    to_light = way / distance_m;
    float share = distance_m / source.position_range.w;
    float window = clamp(1 - share * share * share * share, 0, 1);
    factor = window * window / (distance_m * distance_m);
    if (kind == 2) {
      float cosine = -dot(to_light, source.direction_kind.xyz);
      float cone = clamp((cosine - source.cone_uv_layer.x) * source.cone_uv_layer.y, 0, 1);
      factor *= cone * cone;
    } else {
      face = cube_face(-way);
    }
  }
  factor *= dot(n, to_light);
  if (factor <= 0) return vec3(0);
  int map = int(source.intensity_map.w) + face;
  float layer = source.cone_uv_layer.w + float(face);
  if (source.intensity_map.w >= 0) {
    factor *= kind == 0 ? reached(directional_maps, layer, map_from_world[map], source.cone_uv_layer.z, v_world, n,
                                  to_light)
                        : reached(local_maps, layer, map_from_world[map], source.cone_uv_layer.z, v_world, n, to_light);
  }
  return factor * source.intensity_map.xyz;
}
#endif
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
#ifdef SOURCES
  for (int i = 0; i < source_count; ++i) light += from_source(sources[i], n);
#endif
  out_lit = vec4(base * light, 1);
#elif defined(OUT_LIT)
  out_lit = vec4(base, 1);
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

const char* const kResolveVertexShader = R"(
void main() {
  gl_Position = vec4(vec2((gl_VertexID << 1) & 2, gl_VertexID & 2) * 2 - 1, 0, 1);
}
)";

const char* const kResolveFragmentShader = R"(
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

}  // namespace splatbus::sim

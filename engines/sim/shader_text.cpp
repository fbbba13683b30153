#include "sim/shader_text.h"

namespace splatbus::sim {

const char* const kVertexShader = R"(
layout(location = 0) in vec3 a_position;
layout(location = 1) in vec3 a_normal;
layout(location = 2) in vec2 a_uv;
layout(location = 3) in vec3 a_tint;
layout(location = 4) in mat4 a_world_from_part;
layout(location = 8) in mat3 a_normal_matrix;
layout(location = 11) in vec4 a_base_and_cutoff;
layout(location = 12) in uvec2 a_id_and_layer;
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
out vec3 v_tint;
flat out vec4 v_base_and_cutoff;
flat out float v_layer;
#endif
#ifdef GEOMETRY
out vec4 v_world_and_depth;
flat out uint v_object_id;
#endif
#if defined(LIT) || defined(GEOMETRY)
out vec3 v_normal;
#endif

void main() {
  vec4 world = a_world_from_part * vec4(a_position, 1);
  gl_Position = clip_from_world * world;
#ifdef TEXTURED
  v_uv = a_uv;
  v_tint = a_tint;
  v_base_and_cutoff = a_base_and_cutoff;
  v_layer = float(a_id_and_layer.y);
#endif
#if defined(LIT) || defined(GEOMETRY)
  v_normal = a_normal_matrix * a_normal;
#endif
#ifdef GEOMETRY
  v_object_id = a_id_and_layer.x;
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
in vec3 v_tint;
flat in vec4 v_base_and_cutoff;
flat in float v_layer;
layout(binding = 0) uniform sampler2DArray base_textures;
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

// A depth map and its camera. Rows of camera_from_world; then uv a metre (2), for a pinhole camera at 1 m, and depth in
// [0, 1], which is z - w / (metres along the axis), or z + w (metres along the axis) where it is orthographic.
struct DepthMap {
  vec4 right, down, forward, scale;
};
vec3 seen_by(DepthMap map, vec4 world) {
  return vec3(dot(map.right, world), dot(map.down, world), dot(map.forward, world));
}

// The share of the taps about p, on a surface with normal n, that the light of a map reaches. All three vectors are in
// the frame of the map's camera; `cosine` is that of n and to_light.
float reached(sampler2DArrayShadow maps, float layer, vec4 scale, bool pinhole, vec3 p, vec3 n, vec3 to_light,
              float cosine) {
  float texel = 1 / float(textureSize(maps, 0).x);
  p += (LIFT_TEXELS * texel * (pinhole ? p.z : 1) / scale.x) * n;
  float metre = 1 / (pinhole ? p.z : 1);
  vec2 uv = 0.5 + scale.xy * metre * p.xy;
  float depth = pinhole ? scale.z - scale.w * metre : scale.z + scale.w * p.z;
  // Edge on, a plane's depth would change without bound within the filter.
  vec3 facing = n + max(0, LEAST_COSINE - cosine) * to_light;
  vec2 slope = -scale.w / (pinhole ? dot(facing, p) : facing.z) * facing.xy / scale.xy;
  float radius = max(softness_m * scale.x * metre, texel);
  vec2 turn = disc_turn();
  float sum = 0;
  for (int i = 0; i < TAPS; ++i) {
    vec2 offset = radius * disc_tap(i, turn);
    sum += texture(maps, vec4(uv + offset, layer, min(depth + dot(offset, slope), 1)));
  }
  return sum / float(TAPS);
}
#endif

#ifdef CASCADES
layout(binding = 1) uniform sampler2DArrayShadow cascade_maps;
layout(location = 22) uniform vec4 cascade_cameras[4 * CASCADES];
layout(location = 22 + 4 * CASCADES) uniform float cascade_layers[CASCADES];

DepthMap cascade_map(int i) {
  return DepthMap(cascade_cameras[4 * i], cascade_cameras[4 * i + 1], cascade_cameras[4 * i + 2],
                  cascade_cameras[4 * i + 3]);
}

float sun_visibility(vec3 n) {
  int cascade = 0;
  vec4 world = vec4(v_world, 1);
  for (; cascade + 1 < CASCADES; ++cascade) {
    DepthMap map = cascade_map(cascade);
    vec2 uv = abs(map.scale.xy * seen_by(map, world).xy);
    if (max(uv.x, uv.y) < 0.48) break;
  }
  DepthMap map = cascade_map(cascade);
  return reached(cascade_maps, cascade_layers[cascade], map.scale, false, seen_by(map, world), seen_by(map, vec4(n, 0)),
                 seen_by(map, vec4(sun_direction, 0)), dot(n, sun_direction));
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
  vec4 direction_kind;   // splatbus_light_kind
  vec4 intensity_layer;  // over pi; its first layer, below 0: it casts no shadow
  vec4 cone;             // cosine of the outer angle, 1 / (inner - outer)
  DepthMap map;          // of a point light only the scale counts
};
layout(std140, binding = 0) uniform Sources {
  Source sources[SOURCES];  // point and spot lights, then directional ones
  int local_count, source_count;
};
layout(binding = 2) uniform sampler2DArrayShadow local_maps;
layout(binding = 3) uniform sampler2DArrayShadow directional_maps;

// Along the camera of a point light's face: light_maps.h, point_face_camera().
vec3 in_face(vec3 v, int axis, float side) {
  if (axis == 0) return vec3(side * v.z, -v.y, side * v.x);
  if (axis == 1) return vec3(-side * v.z, -v.x, side * v.y);
  return vec3(-side * v.x, -v.y, side * v.z);
}

// A renderer on the CPU walks through both sides of every branch, so that one call of reached() serves both kinds.
// Irradiance as schemas/common.fbs, LightSource.
vec3 from_local(Source source, vec3 n) {
  bool is_point = source.direction_kind.w == 1;
  vec3 way = v_world - source.position_range.xyz;
  float distance_m = max(length(way), 0.01);
  vec3 to_light = -way / distance_m;
  float share = distance_m / source.position_range.w;
  float window = clamp(1 - share * share * share * share, 0, 1);
  float cone = clamp((-dot(to_light, source.direction_kind.xyz) - source.cone.x) * source.cone.y, 0, 1);
  float cosine = dot(n, to_light);
  float factor = window * window / (distance_m * distance_m) * max(cosine, 0) * (is_point ? 1 : cone * cone);
  vec3 size = abs(way);
  int axis = size.x >= max(size.y, size.z) ? 0 : size.y >= size.z ? 1 : 2;
  float side = (axis == 0 ? way.x : axis == 1 ? way.y : way.z) < 0 ? -1 : 1;
  vec3 p = is_point ? in_face(way, axis, side) : seen_by(source.map, vec4(v_world, 1));
  vec3 normal = is_point ? in_face(n, axis, side) : seen_by(source.map, vec4(n, 0));
  vec3 to = is_point ? in_face(to_light, axis, side) : seen_by(source.map, vec4(to_light, 0));
  float layer = source.intensity_layer.w + (is_point ? float(2 * axis) + (side < 0 ? 1 : 0) : 0);
  if (factor > 0 && source.intensity_layer.w >= 0)
    factor *= reached(local_maps, layer, source.map.scale, true, p, normal, to, cosine);
  return factor * source.intensity_layer.xyz;
}

vec3 from_directional(Source source, vec3 n) {
  vec3 to_light = source.direction_kind.xyz;
  float cosine = dot(n, to_light);
  float factor = max(cosine, 0);
  if (factor > 0 && source.intensity_layer.w >= 0) {
    factor *= reached(directional_maps, source.intensity_layer.w, source.map.scale, false,
                      seen_by(source.map, vec4(v_world, 1)), seen_by(source.map, vec4(n, 0)),
                      seen_by(source.map, vec4(to_light, 0)), cosine);
  }
  return factor * source.intensity_layer.xyz;
}
#endif
#endif

#ifdef ALBEDO
layout(location = OUT_ALBEDO) out vec4 out_albedo;
#endif

#ifdef GEOMETRY
in vec4 v_world_and_depth;
flat in uint v_object_id;
layout(location = 0) out vec4 out_position;
layout(location = 1) out vec4 out_normal;
layout(location = 2) out float out_depth;
layout(location = 3) out uint out_object_id;
#endif

void main() {
#ifdef TEXTURED
  vec4 texel = texture(base_textures, vec3(v_uv, v_layer));
#ifdef HOLES
  if (texel.a < v_base_and_cutoff.a) discard;
#endif
  vec3 base = texel.rgb * v_base_and_cutoff.rgb * v_tint;
#endif
#if defined(LIT) || defined(GEOMETRY)
  vec3 n = normalize(gl_FrontFacing ? v_normal : -v_normal);
#endif
#ifdef LIT
  vec3 light = ambient_reflected(n);
  float cosine = dot(n, sun_direction);
  if (cosine > 0 && sun_over_pi != vec3(0)) light += sun_over_pi * (cosine * sun_visibility(n));
#ifdef SOURCES
  for (int i = 0; i < local_count; ++i) light += from_local(sources[i], n);
  for (int i = local_count; i < source_count; ++i) light += from_directional(sources[i], n);
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
  out_object_id = v_object_id;
#endif
}
)";

const char* const kBoxVertexShader = R"(
layout(location = 0) in vec3 a_position;
layout(location = 4) in mat4 a_world_from_box;
layout(location = 13) in uint a_object;
layout(location = 2) uniform mat4 clip_from_world;
flat out uint v_object;

void main() {
  v_object = a_object;
  gl_Position = clip_from_world * (a_world_from_box * vec4(a_position, 1));
}
)";

const char* const kBoxFragmentShader = R"(
layout(early_fragment_tests) in;
layout(std430, binding = 0) writeonly buffer Seen { uint seen[]; };
flat in uint v_object;

void main() {
  seen[v_object] = 1;
}
)";

const char* const kInstanceShader = R"(
layout(local_size_x = 64) in;
struct Command {
  uint index_count, instance_count, first_index;
  int first_vertex;
  uint part;
};
layout(std430, binding = 0) readonly buffer Seen { uint seen[]; };
layout(std430, binding = 1) buffer Commands { Command commands[]; };
layout(std430, binding = 2) readonly buffer Objects { uint object_of[]; };
layout(location = 0) uniform uint count;

void main() {
  uint i = gl_GlobalInvocationID.x;
  if (i < count) commands[i].instance_count = seen[object_of[commands[i].part]];
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

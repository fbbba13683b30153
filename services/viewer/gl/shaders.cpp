#include "viewer/gl/shaders.h"

namespace splatbus::viewer::gl {

const char* const kScatterText = R"glsl(#version 450 core
layout(local_size_x = 256) in;
layout(std430, binding = 0) readonly buffer ChangedRows { uint changed_rows[]; };
layout(std430, binding = 1) readonly buffer Changed { uint changed[]; };
layout(std430, binding = 2) writeonly buffer Store { uint store[]; };
layout(location = 0) uniform uint uBegin;
layout(location = 1) uniform uint uEnd;
layout(location = 2) uniform uvec3 uWords;  // a row's, of how many in the store, from which on
void main() {
  uint i = uBegin + gl_GlobalInvocationID.x;
  if (i < uEnd) store[uWords.y * changed_rows[i / uWords.x] + uWords.z + i % uWords.x] = changed[i];
}
)glsl";

const char* const kKeepText = R"glsl(#version 450 core
layout(local_size_x = 256) in;
layout(std430, binding = 0) readonly buffer ChangedRows { uint changed_rows[]; };
layout(std430, binding = 1) readonly buffer Records { uvec4 records[]; };
layout(std430, binding = 2) writeonly buffer Kept { uint kept[]; };
layout(location = 0) uniform uint uRows;
layout(location = 1) uniform bool uChanged;
void main() {
  uint i = gl_GlobalInvocationID.x;
  if (i >= uRows) return;
  uint row = uChanged ? changed_rows[i] : i;
  kept[row] = records[2u * row + 1u].w;
}
)glsl";

const char* const kProjectText = R"glsl(#version 450 core
layout(local_size_x = 256) in;
layout(std430, binding = 0) readonly buffer Records { uvec4 records[]; };  // mean xyz, log scale xy; log scale z and
                                                                           // rotation, opacity and object, color
layout(std430, binding = 1) readonly buffer Fades { float fades[]; };
layout(std430, binding = 2) readonly buffer Harmonics { uint harmonics[]; };
layout(std430, binding = 3) readonly buffer Objects { vec4 objects[]; };  // [3] each: camera_from_object
layout(std430, binding = 4) writeonly buffer Splats { uvec4 splats[]; };  // centre, root xy; root z, log2 of alpha, color
layout(std430, binding = 5) writeonly buffer Keys { uint keys[]; };
layout(std430, binding = 6) writeonly buffer GroupCounts { uint group_counts[]; };
layout(std430, binding = 7) readonly buffer Kept { uint kept[]; };  // colors before
layout(location = 0) uniform uint uRows;
layout(location = 1) uniform vec4 uPinhole;   // fx, fy, cx, cy
layout(location = 2) uniform vec2 uSize;
layout(location = 3) uniform vec4 uTangents;  // low x, high x, low y, high y
layout(location = 4) uniform float uTime;
layout(location = 5) uniform bool uAntialias;
layout(location = 6) uniform uint uHarmonicWords;  // 0: colors do not depend on where one looks from
layout(location = 7) uniform float uNear;
layout(location = 8) uniform float uColorPart;  // from the kept colors to the records'

const float kFade_s = 0.25;
const uint kUnseen = 0xffffffffu;
const uint kMostKey = 0x1ffffffu;
// The bits of 2^-11 m. Above them 25 bits are 32 octaves of a million steps each.
const uint kLeastDepth = 0x3a000000u;
)glsl"
#include "viewer/gl/splat_glsl.inc"
                                 R"glsl(
// [coefficient][RGB] as half floats; `d` in the object's frame, from the eye.
vec3 radianceOf(uint row, vec3 d) {
  float basis[16];
  harmonicBasis(d, basis);
  vec3 sum = vec3(0.0);
  for (uint word = 0u; word < 24u; ++word) {
    if (word >= uHarmonicWords) break;
    vec2 two = unpackHalf2x16(harmonics[row * uHarmonicWords + word]);
    uint at = 2u * word;
    sum[at % 3u] += basis[at / 3u] * two.x;
    sum[(at + 1u) % 3u] += basis[(at + 1u) / 3u] * two.y;
  }
  return max(sum, 0.0);
}

vec3 shadeOf(uint row, uint word) {
  vec3 color = colorOf(word);
  if (uColorPart < 1.0) color = mix(colorOf(kept[row]), color, uColorPart);
  return color;
}

float fadeOf(float since) {
  float part = clamp((uTime - abs(since)) / kFade_s, 0.0, 1.0);
  return since < 0.0 ? 1.0 - part : part;
}

uint keyOf(uint row) {
  uvec4 geometry = records[2u * row];
  uvec4 appearance = records[2u * row + 1u];
  float opacity = float(appearance.z & 0xffu) / 255.0 * fadeOf(fades[row]);
  if (opacity < kAlphaMin) return kUnseen;
  uint object = 3u * (appearance.z >> 8);
  if (object + 2u >= uint(objects.length())) return kUnseen;
  vec4 w0 = objects[object], w1 = objects[object + 1u], w2 = objects[object + 2u];
  vec4 mean = vec4(uintBitsToFloat(geometry.xyz), 1.0);
  vec3 point = vec3(dot(w0, mean), dot(w1, mean), dot(w2, mean));
  if (!(point.z > uNear && point.z < 1e15)) return kUnseen;

  Splat splat;
  mat3 w = mat3(w0.xyz, w1.xyz, w2.xyz);
  if (!splatOf(View(uPinhole, uSize, uTangents, uAntialias), geometry, appearance, w, point, opacity, splat)) return kUnseen;
  vec3 color = uHarmonicWords == 0u
      ? shadeOf(row, appearance.w)
      : radianceOf(row, normalize(w0.xyz * point.x + w1.xyz * point.y + w2.xyz * point.z));
  splats[2u * row] = floatBitsToUint(vec4(splat.centre, splat.root.xy));
  splats[2u * row + 1u] = uvec4(floatBitsToUint(vec2(splat.root.z, splat.log2Alpha)), packHalf2x16(color.rg),
                                packHalf2x16(vec2(color.b, 0.0)));
  return kMostKey - min((max(floatBitsToUint(point.z), kLeastDepth) - kLeastDepth) >> 3u, kMostKey);
}

shared uint seen;
void main() {
  if (gl_LocalInvocationIndex == 0u) seen = 0u;
  memoryBarrierShared();
  barrier();
  uint row = gl_GlobalInvocationID.x;
  if (row < uRows) {
    uint key = keyOf(row);
    keys[row] = key;
    if (key != kUnseen) atomicAdd(seen, 1u);
  }
  memoryBarrierShared();
  barrier();
  if (gl_LocalInvocationIndex == 0u) group_counts[gl_WorkGroupID.x] = seen;
}
)glsl";
static_assert(kThreads == 256 && kKeyBits == 25 && kFade_s == 0.25F);

const char* const kSplatVertexText = R"glsl(#version 450 core
layout(std430, binding = 0) readonly buffer Seen { uint seen_rows; };
layout(std430, binding = 1) readonly buffer Order { uint order[]; };
layout(std430, binding = 2) readonly buffer Splats { uvec4 splats[]; };
layout(location = 2) uniform vec2 uSize;

out vec2 vWhite;
flat out vec4 vColor;  // rgb, log2 of alpha in the middle

const uint kBatch = 128u;
)glsl"
#include "viewer/gl/splat_glsl.inc"
                                     R"glsl(
void main() {
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  uint rank = uint(gl_InstanceID) * kBatch + (uint(gl_VertexID) >> 2u);
  if (rank >= seen_rows) return;
  uint row = order[rank];
  vec4 low = uintBitsToFloat(splats[2u * row]);
  uvec4 high = splats[2u * row + 1u];
  Splat splat = Splat(low.xy, vec3(low.zw, uintBitsToFloat(high.x)), uintBitsToFloat(high.y));
  vec2 corner = vec2(gl_VertexID & 1, (gl_VertexID >> 1) & 1) * 2.0 - 1.0;
  gl_Position = cornerOf(uSize, splat, corner, vWhite);
  vColor = vec4(unpackHalf2x16(high.z), unpackHalf2x16(high.w).x, splat.log2Alpha);
}
)glsl";
static_assert(kBatch == 128);

const char* const kSplatFragmentText = R"glsl(#version 450 core
in vec2 vWhite;
flat in vec4 vColor;
layout(location = 0) out vec4 oColor;
void main() {
  float log2Alpha = vColor.a - dot(vWhite, vWhite);
  if (log2Alpha < -7.9943534) discard;
  float alpha = min(exp2(log2Alpha), 0.999);
  oColor = vec4(vColor.rgb * alpha, alpha);
}
)glsl";

const char* const kResolveVertexText = R"glsl(#version 450 core
out vec2 vAt;
void main() {
  vAt = vec2((gl_VertexID << 1) & 2, gl_VertexID & 2);
  gl_Position = vec4(vAt * 2.0 - 1.0, 0.0, 1.0);
}
)glsl";

const char* const kResolveFragmentText = R"glsl(#version 450 core
layout(binding = 0) uniform sampler2D uSplats;
layout(location = 0) uniform vec3 uBackground;
layout(location = 1) uniform bool uDisplaySpace;
in vec2 vAt;
layout(location = 0) out vec4 oColor;
void main() {
  vec4 splats = texture(uSplats, vAt);
  vec3 linear = clamp(splats.rgb + (1.0 - splats.a) * uBackground, 0.0, 1.0);
  vec3 curve = 1.055 * pow(max(linear, 1e-9), vec3(1.0 / 2.4)) - 0.055;
  curve = mix(curve, 12.92 * linear, lessThanEqual(linear, vec3(0.0031308)));
  oColor = vec4(uDisplaySpace ? linear : curve, 1.0);
}
)glsl";

}  // namespace splatbus::viewer::gl

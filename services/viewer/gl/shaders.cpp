#include "viewer/gl/shaders.h"

namespace splatbus::viewer::gl {

const char* const kSplatVertexText = R"glsl(#version 450 core
layout(std430, binding = 0) readonly buffer Records { uvec4 records[]; };  // mean xyz, log scale xy; log scale z and
                                                                            // rotation, opacity and object, color
layout(std430, binding = 1) readonly buffer Fades { float fades[]; };
layout(std430, binding = 2) readonly buffer Order { uint order[]; };
layout(std430, binding = 3) readonly buffer Objects { vec4 objects[]; };
layout(std430, binding = 4) readonly buffer Harmonics { uint harmonics[]; };
layout(location = 0) uniform int uCount;
layout(location = 1) uniform vec4 uPinhole;   // fx, fy, cx, cy
layout(location = 2) uniform vec2 uSize;
layout(location = 3) uniform vec4 uTangents;  // low x, high x, low y, high y
layout(location = 4) uniform float uTime;
layout(location = 5) uniform bool uAntialias;
layout(location = 6) uniform int uHarmonicWords;  // 0: colors do not depend on where one looks from
layout(location = 11) uniform float uNear;

out vec2 vWhite;
flat out vec4 vColor;  // rgb, log2 of alpha in the middle

const int kBatch = 128;
const float kFade_s = 0.25;
)glsl"
#include "viewer/gl/splat_glsl.inc"
                                     R"glsl(
// [coefficient][RGB] as half floats; `d` in the object's frame, from the eye.
vec3 radianceOf(uint row, vec3 d) {
  float basis[16];
  harmonicBasis(d, basis);
  float values[48];
  for (int k = 0; k < 48; ++k) values[k] = 0.0;
  for (int word = 0; word < min(uHarmonicWords, 24); ++word) {
    vec2 two = unpackHalf2x16(harmonics[row * uint(uHarmonicWords) + uint(word)]);
    values[2 * word] = two.x;
    values[2 * word + 1] = two.y;
  }
  vec3 sum = vec3(0.0);
  for (int k = 0; k < 16; ++k) sum += basis[k] * vec3(values[3 * k], values[3 * k + 1], values[3 * k + 2]);
  return max(sum, 0.0);
}

float fadeOf(float since) {
  float part = clamp((uTime - abs(since)) / kFade_s, 0.0, 1.0);
  return since < 0.0 ? 1.0 - part : part;
}

void main() {
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  int rank = gl_InstanceID * kBatch + (gl_VertexID >> 2);
  if (rank >= uCount) return;
  uint row = order[rank];
  uvec4 geometry = records[2u * row];
  uvec4 appearance = records[2u * row + 1u];
  float opacity = float(appearance.z & 0xffu) / 255.0 * fadeOf(fades[row]);
  if (opacity < kAlphaMin) return;

  uint object = 3u * (appearance.z >> 8);
  vec4 w0 = objects[object], w1 = objects[object + 1u], w2 = objects[object + 2u];
  vec4 mean = vec4(uintBitsToFloat(geometry.xyz), 1.0);
  vec3 point = vec3(dot(w0, mean), dot(w1, mean), dot(w2, mean));
  if (!(point.z > uNear && point.z < 1e15)) return;

  Corner corner;
  mat3 w = mat3(w0.xyz, w1.xyz, w2.xyz);
  if (!cornerOf(View(uPinhole, uSize, uTangents, uAntialias), geometry, appearance, w, point, opacity, gl_VertexID, corner)) return;
  gl_Position = corner.position;
  vWhite = corner.white;
  vec3 color = uHarmonicWords == 0
      ? colorOf(appearance.w)
      : radianceOf(row, normalize(w0.xyz * point.x + w1.xyz * point.y + w2.xyz * point.z));
  vColor = vec4(color, corner.log2Alpha);
}
)glsl";

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
layout(location = 7) uniform vec3 uBackground;
layout(location = 8) uniform bool uDisplaySpace;
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

const char* const kScatterText = R"glsl(#version 450 core
layout(local_size_x = 64) in;
layout(std430, binding = 0) buffer Records { uvec4 records[]; };
layout(std430, binding = 1) writeonly buffer Fades { float fades[]; };
layout(std430, binding = 5) readonly buffer ChangedRows { uint changed_rows[]; };
layout(std430, binding = 6) readonly buffer ChangedRecords { uint changed[]; };
layout(std430, binding = 7) readonly buffer ChangedFades { float changed_fades[]; };
layout(location = 9) uniform uint uChanged;
layout(location = 10) uniform bool uColorOnly;
void main() {
  uint i = gl_GlobalInvocationID.x;
  if (i >= uChanged) return;
  uint row = changed_rows[i];
  if (uColorOnly) {
    records[2u * row + 1u].w = changed[i];
    return;
  }
  records[2u * row] = uvec4(changed[8u * i], changed[8u * i + 1u], changed[8u * i + 2u], changed[8u * i + 3u]);
  records[2u * row + 1u] = uvec4(changed[8u * i + 4u], changed[8u * i + 5u], changed[8u * i + 6u], changed[8u * i + 7u]);
  fades[row] = changed_fades[i];
}
)glsl";

}  // namespace splatbus::viewer::gl

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
const float kBlur = 0.3;
const float kAlphaMin = 1.0 / 255.0;
const float kWhiteScale = 0.8493218002880191;  // alpha = 2^(log2 alpha - |this x|^2)

vec2 signedHalves(uint word) {
  return vec2(ivec2(int(word << 16) >> 16, int(word) >> 16));
}

mat3 rotationOf(vec3 vector) {
  float angle = length(vector);
  float part = angle > 1e-6 ? sin(0.5 * angle) / angle : 0.5;
  vec4 q = vec4(vector * part, cos(0.5 * angle));
  vec3 d = q.xyz + q.xyz;
  vec3 xx = q.x * d, yy = q.y * d, w = q.w * d;
  float zz = q.z * d.z;
  return mat3(1.0 - (yy.y + zz), xx.y + w.z, xx.z - w.y,
              xx.y - w.z, 1.0 - (xx.x + zz), yy.z + w.x,
              xx.z + w.y, yy.z - w.x, 1.0 - (xx.x + yy.y));
}

vec3 colorOf(uint word) {
  uvec3 mantissa = uvec3(word, word >> 9, word >> 18) & 0x1ffu;
  return vec3(mantissa) * exp2(float(int(word >> 27) - 24));
}

// [coefficient][RGB] as half floats; `d` in the object's frame, from the eye.
vec3 radianceOf(uint row, vec3 d) {
  float xx = d.x * d.x, yy = d.y * d.y, zz = d.z * d.z;
  float basis[16] = float[16](
    1.0,
    -0.4886025119 * d.y, 0.4886025119 * d.z, -0.4886025119 * d.x,
    1.0925484306 * d.x * d.y, -1.0925484306 * d.y * d.z, 0.3153915653 * (2.0 * zz - xx - yy), -1.0925484306 * d.x * d.z,
    0.5462742153 * (xx - yy),
    -0.5900435899 * d.y * (3.0 * xx - yy), 2.8906114426 * d.x * d.y * d.z, -0.4570457995 * d.y * (4.0 * zz - xx - yy),
    0.3731763326 * d.z * (2.0 * zz - 3.0 * xx - 3.0 * yy), -0.4570457995 * d.x * (4.0 * zz - xx - yy),
    1.4453057213 * d.z * (xx - yy), -0.5900435899 * d.x * (xx - 3.0 * yy));
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

  vec2 tangent = point.xy / point.z;
  vec2 centre = tangent * uPinhole.xy + uPinhole.zw;
  tangent = clamp(tangent, uTangents.xz, uTangents.yw);
  vec2 j = uPinhole.xy / point.z;
  mat3 rotation = rotationOf(vec3(signedHalves(appearance.x).y, signedHalves(appearance.y)) * (3.14159265358979 / 32767.0));
  vec3 size = exp(vec3(signedHalves(geometry.w), signedHalves(appearance.x).x) / 1024.0);
  vec3 m0 = ((j.x * (w0.xyz - tangent.x * w2.xyz)) * rotation) * size;
  vec3 m1 = ((j.y * (w1.xyz - tangent.y * w2.xyz)) * rotation) * size;
  float a = dot(m0, m0), b = dot(m0, m1), c = dot(m1, m1) + kBlur;
  vec3 minor = cross(m0, m1);
  float sharp = dot(minor, minor);
  float blurred = sharp + kBlur * (a + c);
  a += kBlur;
  if (!(blurred > 0.0 && blurred < 1e30)) return;
  float alpha = uAntialias ? opacity * sqrt(sharp / blurred) : opacity;
  if (alpha < kAlphaMin) return;

  float log2Alpha = log2(alpha);
  float reach = sqrt(max(log2Alpha + 7.9943534, 0.0));  // white units
  vec2 extent = reach / kWhiteScale * sqrt(vec2(a, c)) + 0.01;
  if (any(lessThan(centre + extent, vec2(0.5))) || any(greaterThan(centre - extent, uSize - 0.5))) return;

  vec2 white = (vec2(gl_VertexID & 1, (gl_VertexID >> 1) & 1) * 2.0 - 1.0) * (reach + 0.02);
  float rootC = sqrt(c);
  vec2 offset = vec2(sqrt(blurred) / rootC * white.x + b / rootC * white.y, rootC * white.y) / kWhiteScale;
  vec2 pixel = centre + offset;
  gl_Position = vec4(2.0 * pixel.x / uSize.x - 1.0, 1.0 - 2.0 * pixel.y / uSize.y, 0.0, 1.0);
  vWhite = white;
  vec3 color = uHarmonicWords == 0
      ? colorOf(appearance.w)
      : radianceOf(row, normalize(w0.xyz * point.x + w1.xyz * point.y + w2.xyz * point.z));
  vColor = vec4(color, log2Alpha);
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

// Quads that cover exactly what a Gaussian can reach: a square in the whitened plane, brought to pixels by the Cholesky
// factor of the covariance. Any root of it would do; all have the same area.
import { kBatch } from '../quads';
import { kOrderWidth, kRowsWide } from './layout';
import { kFadeS } from '../renderer';

export const kSplatVertex = `#version 300 es
precision highp float;
precision highp int;
precision highp usampler2D;
precision highp sampler2D;

uniform usampler2D uGeometry;    // mean xyz, log scale xy
uniform usampler2D uAppearance;  // log scale z and rotation, opacity and object, color
uniform sampler2D uFade;
uniform usampler2D uOrder;
uniform sampler2D uObjects;      // camera_from_object, three texels an object
uniform usampler2D uHarmonics;
uniform int uHarmonicTexels;     // of a row, eight half floats each; 0: colors do not depend on where one looks from
uniform int uCount;
uniform int uObjectsWide;        // objects a row of uObjects
uniform vec4 uPinhole;           // fx, fy, cx, cy
uniform vec2 uSize;
uniform vec4 uTangents;          // low x, high x, low y, high y
uniform float uTime;

out vec2 vWhite;
flat out vec4 vColor;           // rgb, log2 of alpha in the middle

const float kBlur = 0.3;
const float kNear = 0.05;
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

vec3 radianceOf(int row, vec3 d) {
  float xx = d.x * d.x, yy = d.y * d.y, zz = d.z * d.z;
  float basis[16] = float[16](
    1.0,
    -0.4886025119 * d.y, 0.4886025119 * d.z, -0.4886025119 * d.x,
    1.0925484306 * d.x * d.y, -1.0925484306 * d.y * d.z, 0.3153915653 * (2.0 * zz - xx - yy), -1.0925484306 * d.x * d.z,
    0.5462742153 * (xx - yy),
    -0.5900435899 * d.y * (3.0 * xx - yy), 2.8906114426 * d.x * d.y * d.z, -0.4570457995 * d.y * (4.0 * zz - xx - yy),
    0.3731763326 * d.z * (2.0 * zz - 3.0 * xx - 3.0 * yy), -0.4570457995 * d.x * (4.0 * zz - xx - yy),
    1.4453057213 * d.z * (xx - yy), -0.5900435899 * d.x * (xx - 3.0 * yy));
  vec3 sum = vec3(0.0);
  ivec2 first = ivec2(row % ${kRowsWide}, (row / ${kRowsWide}) * uHarmonicTexels);
  for (int texel = 0; texel < uHarmonicTexels; ++texel) {
    uvec4 words = texelFetch(uHarmonics, first + ivec2(0, texel), 0);
    for (int i = 0; i < 4; ++i) {
      vec2 two = unpackHalf2x16(words[i]);
      int at = 8 * texel + 2 * i;
      sum[at % 3] += basis[at / 3] * two.x;
      sum[(at + 1) % 3] += basis[(at + 1) / 3] * two.y;
    }
  }
  return max(sum, 0.0);
}

float fadeOf(float since) {
  float part = clamp((uTime - abs(since)) * ${(1 / kFadeS).toFixed(4)}, 0.0, 1.0);
  return since < 0.0 ? 1.0 - part : part;
}

void main() {
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  int rank = gl_InstanceID * ${kBatch} + (gl_VertexID >> 2);
  if (rank >= uCount) return;
  int row = int(texelFetch(uOrder, ivec2(rank % ${kOrderWidth}, rank / ${kOrderWidth}), 0).x);
  ivec2 at = ivec2(row % ${kRowsWide}, row / ${kRowsWide});
  uvec4 geometry = texelFetch(uGeometry, at, 0);
  uvec4 appearance = texelFetch(uAppearance, at, 0);
  float opacity = float(appearance.z & 0xffu) / 255.0 * fadeOf(texelFetch(uFade, at, 0).x);
  if (opacity < kAlphaMin) return;

  int object = int(appearance.z >> 8);
  ivec2 corner = ivec2(3 * (object % uObjectsWide), object / uObjectsWide);
  vec4 w0 = texelFetch(uObjects, corner, 0);
  vec4 w1 = texelFetch(uObjects, corner + ivec2(1, 0), 0);
  vec4 w2 = texelFetch(uObjects, corner + ivec2(2, 0), 0);
  vec4 mean = vec4(uintBitsToFloat(geometry.xyz), 1.0);
  vec3 point = vec3(dot(w0, mean), dot(w1, mean), dot(w2, mean));
  if (!(point.z > kNear && point.z < 1e15)) return;

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
  float alpha = opacity * sqrt(sharp / blurred);
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
  vec3 color = uHarmonicTexels == 0
      ? colorOf(appearance.w)
      : radianceOf(row, normalize(w0.xyz * point.x + w1.xyz * point.y + w2.xyz * point.z));
  vColor = vec4(color, log2Alpha);
}`;

export const kSplatFragment = `#version 300 es
precision highp float;
in vec2 vWhite;
flat in vec4 vColor;
out vec4 oColor;
void main() {
  float log2Alpha = vColor.a - dot(vWhite, vWhite);
  if (log2Alpha < -7.9943534) discard;
  float alpha = min(exp2(log2Alpha), 0.999);
  oColor = vec4(vColor.rgb * alpha, alpha);
}`;

export const kResolveVertex = `#version 300 es
out vec2 vAt;
void main() {
  vAt = vec2((gl_VertexID << 1) & 2, gl_VertexID & 2);
  gl_Position = vec4(vAt * 2.0 - 1.0, 0.0, 1.0);
}`;

export const kResolveFragment = `#version 300 es
precision highp float;
uniform highp sampler2D uSplats;
uniform vec3 uBackground;
uniform bool uDisplaySpace;
in vec2 vAt;
out vec4 oColor;
void main() {
  vec4 splats = texture(uSplats, vAt);
  vec3 linear = clamp(splats.rgb + (1.0 - splats.a) * uBackground, 0.0, 1.0);
  vec3 curve = 1.055 * pow(max(linear, 1e-9), vec3(1.0 / 2.4)) - 0.055;
  curve = mix(curve, 12.92 * linear, lessThanEqual(linear, vec3(0.0031308)));
  oColor = vec4(uDisplaySpace ? linear : curve, 1.0);
}`;

/** Writes changed rows to where they belong: a point a row, so that what is uploaded is what changed. */
export const kScatterVertex = `#version 300 es
precision highp float;
precision highp int;
layout(location = 0) in uint aRow;
layout(location = 1) in uvec4 aGeometry;
layout(location = 2) in uvec4 aAppearance;
layout(location = 3) in float aFade;
layout(location = 4) in uint aColor;  // 0 where the appearance says it
uniform vec2 uStoreSize;
flat out uvec4 vGeometry;
flat out uvec4 vAppearance;
flat out float vFade;
void main() {
  vec2 texel = vec2(float(aRow % ${kRowsWide}u), float(aRow / ${kRowsWide}u)) + 0.5;
  gl_Position = vec4(2.0 * texel / uStoreSize - 1.0, 0.0, 1.0);
  gl_PointSize = 1.0;
  vGeometry = aGeometry;
  vAppearance = aAppearance | uvec4(0u, 0u, 0u, aColor);
  vFade = aFade;
}`;

export const kScatterFragment = `#version 300 es
precision highp float;
precision highp int;
flat in uvec4 vGeometry;
flat in uvec4 vAppearance;
flat in float vFade;
layout(location = 0) out uvec4 oGeometry;
layout(location = 1) out uvec4 oAppearance;
layout(location = 2) out float oFade;
void main() {
  oGeometry = vGeometry;
  oAppearance = vAppearance;
  oFade = vFade;
}`;

/** Writes one texel of rows' harmonics. */
export const kHarmonicVertex = `#version 300 es
precision highp float;
precision highp int;
layout(location = 0) in uint aRow;
layout(location = 1) in uvec4 aWords;
uniform vec2 uStoreSize;
uniform uint uTexel;
uniform uint uTexels;
flat out uvec4 vWords;
void main() {
  vec2 texel = vec2(float(aRow % ${kRowsWide}u), float(aRow / ${kRowsWide}u * uTexels + uTexel)) + 0.5;
  gl_Position = vec4(2.0 * texel / uStoreSize - 1.0, 0.0, 1.0);
  gl_PointSize = 1.0;
  vWords = aWords;
}`;

export const kHarmonicFragment = `#version 300 es
precision highp float;
precision highp int;
flat in uvec4 vWords;
out uvec4 oWords;
void main() { oWords = vWords; }`;

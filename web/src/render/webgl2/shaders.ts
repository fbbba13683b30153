// Rows in textures, and the quads of splat.glsl.
import { kBatch } from '../quads';
import { kOrderWidth, kRowsWide } from './layout';
import { kFadeS } from '../renderer';
import kSplatFunctions from '../splat.glsl';

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

const float kNear = 0.05;
${kSplatFunctions}
vec3 radianceOf(int row, vec3 d) {
  float basis[16];
  harmonicBasis(d, basis);
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
  ivec2 texel = ivec2(3 * (object % uObjectsWide), object / uObjectsWide);
  vec4 w0 = texelFetch(uObjects, texel, 0);
  vec4 w1 = texelFetch(uObjects, texel + ivec2(1, 0), 0);
  vec4 w2 = texelFetch(uObjects, texel + ivec2(2, 0), 0);
  vec4 mean = vec4(uintBitsToFloat(geometry.xyz), 1.0);
  vec3 point = vec3(dot(w0, mean), dot(w1, mean), dot(w2, mean));
  if (!(point.z > kNear && point.z < 1e15)) return;

  Splat splat;
  mat3 w = mat3(w0.xyz, w1.xyz, w2.xyz);
  if (!splatOf(View(uPinhole, uSize, uTangents, true), geometry, appearance, w, point, opacity, splat)) return;
  gl_Position = cornerOf(uSize, splat, gl_VertexID, vWhite);
  vec3 color = uHarmonicTexels == 0
      ? colorOf(appearance.w)
      : radianceOf(row, normalize(w0.xyz * point.x + w1.xyz * point.y + w2.xyz * point.z));
  vColor = vec4(color, splat.log2Alpha);
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

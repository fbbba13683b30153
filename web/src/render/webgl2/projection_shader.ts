// Projection, once a Gaussian.
import { kFadeS } from '../renderer';
import { kOrderWidth, kRowsWide } from './layout';
import kSplatFunctions from '../splat.glsl';

/**
 * Of each rank what its triangle needs, 32 bytes. Of a row that cannot be seen all is 0: a triangle without area.
 */
export const kProjectFragment = `#version 300 es
precision highp float;
precision highp int;
precision highp usampler2D;
precision highp sampler2D;

uniform usampler2D uGeometry;    // mean xyz, log scale xy
uniform usampler2D uAppearance;  // log scale z and rotation, opacity and object, color
uniform sampler2D uFade;
uniform usampler2D uKept;        // color before
uniform float uColorPart;        // from there to the appearance's
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
uniform bool uMip;               // Frame.mip

layout(location = 0) out uvec4 oLow;   // centre, root xy
layout(location = 1) out uvec4 oHigh;  // root z, log2 of alpha in the middle, color

const float kNear = 0.05;
${kSplatFunctions}
vec3 shadeOf(ivec2 at, uint word) {
  vec3 color = colorOf(word);
  if (uColorPart < 1.0) color = mix(colorOf(texelFetch(uKept, at, 0).x), color, uColorPart);
  return color;
}

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
  oLow = uvec4(0u);
  oHigh = uvec4(0u);
  ivec2 rank = ivec2(gl_FragCoord.xy);
  if (rank.y * ${kOrderWidth} + rank.x >= uCount) return;
  int row = int(texelFetch(uOrder, rank, 0).x);
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
  if (!splatOf(View(uPinhole, uSize, uTangents, uMip), geometry, appearance, w, point, opacity, splat)) return;
  vec3 color = uHarmonicTexels == 0
      ? shadeOf(at, appearance.w)
      : radianceOf(row, normalize(w0.xyz * point.x + w1.xyz * point.y + w2.xyz * point.z));
  oLow = floatBitsToUint(vec4(splat.centre, splat.root.xy));
  oHigh = uvec4(floatBitsToUint(vec2(splat.root.z, splat.log2Alpha)), packHalf2x16(color.rg), packHalf2x16(vec2(color.b, 0.0)));
}`;

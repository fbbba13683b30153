// Rows in textures, and the triangles of splat.glsl.
import { kOrderWidth, kRowsWide } from './layout';
import kSplatFunctions from '../splat.glsl';
import { kHalfBase } from '../triangle';

/** A triangle for each of what was projected, far to near. */
export const kSplatVertex = `#version 300 es
precision highp float;
precision highp int;
precision highp usampler2D;
uniform usampler2D uLow;
uniform usampler2D uHigh;
uniform vec2 uSize;
out vec2 vWhite;
flat out vec4 vColor;  // rgb, log2 of alpha in the middle
${kSplatFunctions}
void main() {
  int rank = gl_VertexID / 3;
  ivec2 at = ivec2(rank % ${kOrderWidth}, rank / ${kOrderWidth});
  vec4 low = uintBitsToFloat(texelFetch(uLow, at, 0));
  uvec4 high = texelFetch(uHigh, at, 0);
  Splat splat = Splat(low.xy, vec3(low.zw, uintBitsToFloat(high.x)), uintBitsToFloat(high.y));
  int corner = gl_VertexID % 3;
  gl_Position = cornerOf(uSize, splat, vec2(float(corner - 1) * ${kHalfBase}, corner == 1 ? 2.0 : -1.0), vWhite);
  vColor = vec4(unpackHalf2x16(high.z), unpackHalf2x16(high.w).x, splat.log2Alpha);
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

/** One triangle over all there is. */
export const kWholeVertex = `#version 300 es
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
layout(location = 3) out uint oKept;
void main() {
  oGeometry = vGeometry;
  oAppearance = vAppearance;
  oFade = vFade;
  oKept = vAppearance.w;
}`;

/** Keeps the colors of all rows. */
export const kKeepFragment = `#version 300 es
precision highp float;
precision highp int;
precision highp usampler2D;
uniform usampler2D uAppearance;
out uint oKept;
void main() { oKept = texelFetch(uAppearance, ivec2(gl_FragCoord.xy), 0).w; }`;

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

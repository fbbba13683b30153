// Triangles from what was projected, and the picture from them.
import { kHalfBase } from '../triangle';
import { kSplat, kView } from './shared_shaders';

export const kSplats = `${kView}${kSplat}
@group(0) @binding(1) var<storage, read> order: array<u32>;
@group(0) @binding(2) var<storage, read> splats: array<Splat>;
struct Corner {
  @builtin(position) position: vec4f,
  @location(0) white: vec2f,
  @location(1) @interpolate(flat) color: vec4f,  // rgb, log2 of alpha in the middle
}
@vertex fn vertex(@builtin(vertex_index) index: u32) -> Corner {
  let splat = splats[order[index / 3]];
  let corner = index % 3;
  let white = vec2f((f32(corner) - 1) * ${kHalfBase}, select(-1.0, 2.0, corner == 1)) * (splat.reach + 0.02);
  let pixel = splat.centre + vec2f(dot(splat.root.xy, white), splat.root.z * white.y);
  let ndc = vec2f(2, -2) * pixel / view.size + vec2f(-1, 1);
  return Corner(vec4f(ndc, 0, 1), white, vec4f(color_of(splat.color), splat.log2_alpha));
}
@fragment fn fragment(corner: Corner) -> @location(0) vec4f {
  let log2_alpha = corner.color.a - dot(corner.white, corner.white);
  if (log2_alpha < -7.9943534) { discard; }
  let alpha = min(exp2(log2_alpha), 0.999);
  return vec4f(corner.color.rgb * alpha, alpha);
}`;

export const kResolve = `${kView}
@group(0) @binding(1) var picture: texture_2d<f32>;
@group(0) @binding(2) var between: sampler;
struct Corner {
  @builtin(position) position: vec4f,
  @location(0) at: vec2f,
}
@vertex fn vertex(@builtin(vertex_index) corner: u32) -> Corner {
  let at = vec2f(f32((corner << 1) & 2), f32(corner & 2));
  return Corner(vec4f(at * vec2f(2, -2) + vec2f(-1, 1), 0, 1), at);
}
@fragment fn fragment(corner: Corner) -> @location(0) vec4f {
  let splats = textureSample(picture, between, corner.at);
  let linear = clamp(splats.rgb + (1 - splats.a) * view.background, vec3f(0), vec3f(1));
  let curve = select(1.055 * pow(max(linear, vec3f(1e-9)), vec3f(1 / 2.4)) - 0.055, 12.92 * linear, linear <= vec3f(0.0031308));
  return vec4f(select(curve, linear, view.display_space != 0), 1);
}`;

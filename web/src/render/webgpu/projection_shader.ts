// Projection, once a Gaussian.
import { kFadeS } from '../renderer';
import { kSplat, kThreads, kUnseen, kView } from './shared_shaders';

/** Bits of a key. */
export const kKeyBits = 20;

/** Of every row what its triangle needs, and a key: nearer is greater; kUnseen where nothing can show. */
export const kProject = `${kView}${kSplat}
@group(0) @binding(1) var<storage, read> records: array<vec4u>;
@group(0) @binding(2) var<storage, read> fades: array<f32>;
@group(0) @binding(3) var<storage, read> objects: array<vec4f>;
@group(0) @binding(4) var<storage, read_write> splats: array<Splat>;
@group(0) @binding(5) var<storage, read_write> keys: array<u32>;
@group(0) @binding(6) var<storage, read> harmonics: array<u32>;
@group(0) @binding(7) var<storage, read> kept: array<u32>;

const kBlur = 0.3;
const kNear = 0.05;
const kAlphaMin = 1.0 / 255.0;
const kWhiteScale = 0.8493218002880191;
const kUnseen = ${kUnseen}u;
const kMostKey = ${(1 << kKeyBits) - 1}u;

fn signed_halves(word: u32) -> vec2f {
  return vec2f(vec2i(bitcast<i32>(word << 16) >> 16, bitcast<i32>(word) >> 16));
}

fn rotation_of(vector: vec3f) -> mat3x3f {
  let angle = length(vector);
  let q = vector * select(0.5, sin(0.5 * angle) / angle, angle > 1e-6);
  let d = q + q;
  let xx = q.x * d;
  let yy = q.y * d;
  let w = cos(0.5 * angle) * d;
  let zz = q.z * d.z;
  return mat3x3f(
    1.0 - (yy.y + zz), xx.y + w.z, xx.z - w.y,
    xx.y - w.z, 1.0 - (xx.x + zz), yy.z + w.x,
    xx.z + w.y, yy.z - w.x, 1.0 - (xx.x + yy.y));
}

fn fade_of(since: f32) -> f32 {
  let part = clamp((view.time - abs(since)) * ${(1 / kFadeS).toFixed(4)}, 0.0, 1.0);
  return select(part, 1.0 - part, since < 0.0);
}

fn rgb9e5(color: vec3f) -> u32 {
  let bounded = clamp(color, vec3f(0), vec3f(65408));
  let largest = max(max(bounded.r, bounded.g), max(bounded.b, 3e-5));
  var exponent = clamp(i32(bitcast<u32>(largest) >> 23) - 127 + 16, 0, 31);
  if (floor(largest * exp2(f32(24 - exponent)) + 0.5) >= 512) { exponent += 1; }
  let steps = vec3u(bounded * exp2(f32(24 - exponent)) + 0.5);
  return steps.r | (steps.g << 9) | (steps.b << 18) | (u32(exponent) << 27);
}

fn radiance_of(row: u32, d: vec3f) -> u32 {
  let xx = d.x * d.x;
  let yy = d.y * d.y;
  let zz = d.z * d.z;
  var basis = array<f32, 16>(
    1,
    -0.4886025119 * d.y, 0.4886025119 * d.z, -0.4886025119 * d.x,
    1.0925484306 * d.x * d.y, -1.0925484306 * d.y * d.z, 0.3153915653 * (2 * zz - xx - yy), -1.0925484306 * d.x * d.z,
    0.5462742153 * (xx - yy),
    -0.5900435899 * d.y * (3 * xx - yy), 2.8906114426 * d.x * d.y * d.z, -0.4570457995 * d.y * (4 * zz - xx - yy),
    0.3731763326 * d.z * (2 * zz - 3 * xx - 3 * yy), -0.4570457995 * d.x * (4 * zz - xx - yy),
    1.4453057213 * d.z * (xx - yy), -0.5900435899 * d.x * (xx - 3 * yy));
  var sum = vec3f(0);
  for (var word = 0u; word < view.harmonic_words; word++) {
    let two = unpack2x16float(harmonics[view.harmonic_words * row + word]);
    let at = 2 * word;
    sum[at % 3] += basis[at / 3] * two.x;
    sum[(at + 1) % 3] += basis[(at + 1) / 3] * two.y;
  }
  return rgb9e5(sum);
}

fn project(row: u32) -> u32 {
  let geometry = records[2 * row];
  let appearance = records[2 * row + 1];
  let opacity = f32(appearance.z & 0xffu) / 255.0 * fade_of(fades[row]);
  if (opacity < kAlphaMin) { return kUnseen; }
  let object = 3 * (appearance.z >> 8);
  if (object + 2 >= arrayLength(&objects)) { return kUnseen; }
  let w0 = objects[object];
  let w1 = objects[object + 1];
  let w2 = objects[object + 2];
  let mean = vec4f(bitcast<vec3f>(geometry.xyz), 1.0);
  let point = vec3f(dot(w0, mean), dot(w1, mean), dot(w2, mean));
  if (!(point.z > kNear && point.z < 1e15)) { return kUnseen; }

  let free_tangent = point.xy / point.z;
  let centre = free_tangent * view.pinhole.xy + view.pinhole.zw;
  let tangent = clamp(free_tangent, view.tangents.xz, view.tangents.yw);
  let j = view.pinhole.xy / point.z;
  let turn = vec3f(signed_halves(appearance.x).y, signed_halves(appearance.y)) * (3.14159265358979 / 32767.0);
  let rotation = rotation_of(turn);
  let size = exp(vec3f(signed_halves(geometry.w), signed_halves(appearance.x).x) / 1024.0);
  let m0 = ((j.x * (w0.xyz - tangent.x * w2.xyz)) * rotation) * size;
  let m1 = ((j.y * (w1.xyz - tangent.y * w2.xyz)) * rotation) * size;
  let sharp_a = dot(m0, m0);
  let b = dot(m0, m1);
  let c = dot(m1, m1) + kBlur;
  let minor = cross(m0, m1);
  let sharp = dot(minor, minor);
  let blurred = sharp + kBlur * (sharp_a + c);
  let a = sharp_a + kBlur;
  if (!(blurred > 0.0 && blurred < 1e30)) { return kUnseen; }
  let alpha = opacity * select(1.0, sqrt(sharp / blurred), view.mip != 0);
  if (!(alpha >= kAlphaMin)) { return kUnseen; }

  let log2_alpha = log2(alpha);
  let reach = sqrt(max(log2_alpha + 7.9943534, 0.0));
  let extent = reach / kWhiteScale * sqrt(vec2f(a, c)) + 0.01;
  if (any(centre + extent < vec2f(0.5)) || any(centre - extent > view.size - 0.5)) { return kUnseen; }

  var color = appearance.w;
  if (view.harmonic_words != 0) {
    color = radiance_of(row, normalize(w0.xyz * point.x + w1.xyz * point.y + w2.xyz * point.z));
  } else if (view.color_part < 1) {
    color = rgb9e5(mix(color_of(kept[row]), color_of(color), view.color_part));
  }
  let root_c = sqrt(c);
  splats[row] = Splat(centre, log2_alpha, reach, vec3f(sqrt(blurred) / root_c, b / root_c, root_c) / kWhiteScale, color);
  // The bits of a float above those of 2^-5 m: 16 octaves, 65,536 steps each.
  return kMostKey - min((bitcast<u32>(point.z) - 0x3d000000u) >> 7, kMostKey);
}

@compute @workgroup_size(${kThreads}) fn main(@builtin(global_invocation_id) id: vec3u) {
  if (id.x < view.rows) { keys[id.x] = project(id.x); }
}`;

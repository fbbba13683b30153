// Projection once a Gaussian in compute, a stable radix sort of the depths of what is seen, and quads from the results.
// Nothing needs subgroups, nothing comes back to the page, and equal depths keep the order of rows in every frame.
import { kBatch } from '../quads';
import { kFadeS } from '../renderer';

/** Threads of every workgroup. */
export const kThreads = 256;
/** Keys that one workgroup sorts at a time: barriers cost more than keys do. */
export const kBlock = 16 * kThreads;
/** Bits of a key, and of them those that one pass sorts by. */
export const kKeyBits = 20;
export const kDigitBits = 4;
export const kDigits = 1 << kDigitBits;

const kView = `
struct View {
  pinhole: vec4f,      // fx, fy, cx, cy
  tangents: vec4f,     // low x, high x, low y, high y
  size: vec2f,
  time: f32,
  rows: u32,
  background: vec3f,
  display_space: u32,
  harmonic_words: u32,  // of a row; 0: colors do not depend on where one looks from
}
@group(0) @binding(0) var<uniform> view: View;
`;

const kSplat = `
struct Splat {
  centre: vec2f,
  log2_alpha: f32,
  reach: f32,          // white units
  root: vec3f,         // Cholesky factor of the covariance: xu, xv, yv, pixels a white unit
  color: u32,
}
`;

export const kScatterRows = `
@group(0) @binding(0) var<storage, read> rows: array<u32>;
@group(0) @binding(1) var<storage, read> changed: array<vec4u>;
@group(0) @binding(2) var<storage, read> changed_fades: array<f32>;
@group(0) @binding(3) var<storage, read_write> records: array<vec4u>;
@group(0) @binding(4) var<storage, read_write> fades: array<f32>;
@group(0) @binding(5) var<uniform> count: u32;
@compute @workgroup_size(${kThreads}) fn main(@builtin(global_invocation_id) id: vec3u) {
  if (id.x >= count) { return; }
  let row = rows[id.x];
  records[2 * row] = changed[2 * id.x];
  records[2 * row + 1] = changed[2 * id.x + 1];
  fades[row] = changed_fades[id.x];
}`;

export const kScatterColors = `
@group(0) @binding(0) var<storage, read> rows: array<u32>;
@group(0) @binding(1) var<storage, read> changed: array<u32>;
@group(0) @binding(3) var<storage, read_write> records: array<vec4u>;
@group(0) @binding(5) var<uniform> count: u32;
@compute @workgroup_size(${kThreads}) fn main(@builtin(global_invocation_id) id: vec3u) {
  if (id.x >= count) { return; }
  records[2 * rows[id.x] + 1].w = changed[id.x];
}`;

export const kScatterHarmonics = `
@group(0) @binding(0) var<storage, read> rows: array<u32>;
@group(0) @binding(1) var<storage, read> changed: array<u32>;
@group(0) @binding(3) var<storage, read_write> harmonics: array<u32>;
@group(0) @binding(5) var<uniform> count: vec2u;  // rows, words of each
@compute @workgroup_size(${kThreads}) fn main(@builtin(global_invocation_id) id: vec3u) {
  if (id.x >= count.x) { return; }
  for (var k = 0u; k < count.y; k++) { harmonics[count.y * rows[id.x] + k] = changed[count.y * id.x + k]; }
}`;

/** Of every row what the quads need, and a key: nearer is greater; kUnseen where nothing can show. */
export const kProject = `${kView}${kSplat}
@group(0) @binding(1) var<storage, read> records: array<vec4u>;
@group(0) @binding(2) var<storage, read> fades: array<f32>;
@group(0) @binding(3) var<storage, read> objects: array<vec4f>;
@group(0) @binding(4) var<storage, read_write> splats: array<Splat>;
@group(0) @binding(5) var<storage, read_write> keys: array<u32>;
@group(0) @binding(6) var<storage, read_write> block_counts: array<u32>;
@group(0) @binding(7) var<storage, read> harmonics: array<u32>;

const kBlur = 0.3;
const kNear = 0.05;
const kAlphaMin = 1.0 / 255.0;
const kWhiteScale = 0.8493218002880191;
const kUnseen = 0xffffffffu;
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
  let alpha = opacity * sqrt(sharp / blurred);
  if (!(alpha >= kAlphaMin)) { return kUnseen; }

  let log2_alpha = log2(alpha);
  let reach = sqrt(max(log2_alpha + 7.9943534, 0.0));
  let extent = reach / kWhiteScale * sqrt(vec2f(a, c)) + 0.01;
  if (any(centre + extent < vec2f(0.5)) || any(centre - extent > view.size - 0.5)) { return kUnseen; }

  var color = appearance.w;
  if (view.harmonic_words != 0) {
    color = radiance_of(row, normalize(w0.xyz * point.x + w1.xyz * point.y + w2.xyz * point.z));
  }
  let root_c = sqrt(c);
  splats[row] = Splat(centre, log2_alpha, reach, vec3f(sqrt(blurred) / root_c, b / root_c, root_c) / kWhiteScale, color);
  // The bits of a float above those of 2^-5 m: 16 octaves, 65,536 steps each.
  return kMostKey - min((bitcast<u32>(point.z) - 0x3d000000u) >> 7, kMostKey);
}

var<workgroup> seen: atomic<u32>;
@compute @workgroup_size(${kThreads}) fn main(
    @builtin(global_invocation_id) id: vec3u, @builtin(workgroup_id) block: vec3u, @builtin(local_invocation_index) thread: u32) {
  var key = kUnseen;
  if (id.x < view.rows) {
    key = project(id.x);
    keys[id.x] = key;
  }
  if (key != kUnseen) { atomicAdd(&seen, 1u); }
  workgroupBarrier();
  if (thread == 0) { block_counts[block.x] = atomicLoad(&seen); }
}`;

const kWorkgroupScan = `
var<workgroup> partial: array<u32, ${kThreads}>;
/** Sum over the threads before this one; the sum over all is left in partial[${kThreads - 1}]. */
fn sum_before(thread: u32, value: u32) -> u32 {
  partial[thread] = value;
  for (var step = 1u; step < ${kThreads}; step *= 2) {
    workgroupBarrier();
    let other = select(0u, partial[max(thread, step) - step], thread >= step);
    workgroupBarrier();
    partial[thread] += other;
  }
  workgroupBarrier();
  return partial[thread] - value;
}
`;

/** Where the seen rows of each block go; how many there are, and so what is to be dispatched and drawn. */
export const kCountSeen = `${kView}${kWorkgroupScan}
@group(0) @binding(1) var<storage, read_write> block_counts: array<u32>;
@group(0) @binding(2) var<storage, read_write> seen: array<u32>;      // [1]
@group(0) @binding(3) var<storage, read_write> sort_args: array<u32>; // [3]
@group(0) @binding(4) var<storage, read_write> draw_args: array<u32>; // [5]
@compute @workgroup_size(${kThreads}) fn main(@builtin(local_invocation_index) thread: u32) {
  let blocks = (view.rows + ${kThreads - 1}) / ${kThreads};
  let each = (blocks + ${kThreads - 1}) / ${kThreads};
  let begin = min(thread * each, blocks);
  let end = min(begin + each, blocks);
  var sum = 0u;
  for (var i = begin; i < end; i++) { sum += block_counts[i]; }
  var at = sum_before(thread, sum);
  for (var i = begin; i < end; i++) {
    let count = block_counts[i];
    block_counts[i] = at;
    at += count;
  }
  if (thread == 0) {
    let total = partial[${kThreads - 1}];
    seen[0] = total;
    sort_args[0] = (total + ${kBlock - 1}) / ${kBlock};
    sort_args[1] = 1;
    sort_args[2] = 1;
    draw_args[0] = ${6 * kBatch};
    draw_args[1] = (total + ${kBatch - 1}) / ${kBatch};
    draw_args[2] = 0;
    draw_args[3] = 0;
    draw_args[4] = 0;
  }
}`;

/** The seen rows and their keys, closed up. */
export const kCloseUp = `${kView}${kWorkgroupScan}
@group(0) @binding(1) var<storage, read> keys: array<u32>;
@group(0) @binding(2) var<storage, read> block_begin: array<u32>;
@group(0) @binding(3) var<storage, read_write> seen_keys: array<u32>;
@group(0) @binding(4) var<storage, read_write> seen_rows: array<u32>;
@compute @workgroup_size(${kThreads}) fn main(
    @builtin(global_invocation_id) id: vec3u, @builtin(workgroup_id) block: vec3u, @builtin(local_invocation_index) thread: u32) {
  var key = 0xffffffffu;
  if (id.x < view.rows) { key = keys[id.x]; }
  let is_seen = key != 0xffffffffu;
  let before = sum_before(thread, u32(is_seen));
  if (is_seen) {
    let at = block_begin[block.x] + before;
    seen_keys[at] = key;
    seen_rows[at] = id.x;
  }
}`;

const kSortInput = `
@group(0) @binding(0) var<uniform> shift: u32;
@group(0) @binding(1) var<storage, read> seen: array<u32>;
@group(0) @binding(2) var<storage, read> keys: array<u32>;
fn digit_of(key: u32) -> u32 { return (key >> shift) & ${kDigits - 1}u; }
`;

/** How often each digit occurs in each block: [digit][block]. */
export const kHistogram = `${kSortInput}
@group(0) @binding(3) var<storage, read_write> counts: array<u32>;
var<workgroup> local: array<atomic<u32>, ${kDigits}>;
@compute @workgroup_size(${kThreads}) fn main(
    @builtin(workgroup_id) block: vec3u, @builtin(num_workgroups) blocks: vec3u, @builtin(local_invocation_index) thread: u32) {
  for (var i = 0u; i < ${kBlock / kThreads}; i++) {
    let at = block.x * ${kBlock} + thread * ${kBlock / kThreads} + i;
    if (at < seen[0]) { atomicAdd(&local[digit_of(keys[at])], 1u); }
  }
  workgroupBarrier();
  if (thread < ${kDigits}) { counts[thread * blocks.x + block.x] = atomicLoad(&local[thread]); }
}`;

/** Counts to where each digit of each block begins. */
export const kScanCounts = `${kWorkgroupScan}
@group(0) @binding(1) var<storage, read> seen: array<u32>;
@group(0) @binding(3) var<storage, read_write> counts: array<u32>;
@compute @workgroup_size(${kThreads}) fn main(@builtin(local_invocation_index) thread: u32) {
  let n = (seen[0] + ${kBlock - 1}) / ${kBlock} * ${kDigits};
  let each = (n + ${kThreads - 1}) / ${kThreads};
  let begin = min(thread * each, n);
  let end = min(begin + each, n);
  var sum = 0u;
  for (var i = begin; i < end; i++) { sum += counts[i]; }
  var at = sum_before(thread, sum);
  for (var i = begin; i < end; i++) {
    let count = counts[i];
    counts[i] = at;
    at += count;
  }
}`;

/** Every key to its place by this digit; those with the same digit keep their order. Sixteen counters of 16 bits a thread. */
export const kReorder = `${kSortInput}
@group(0) @binding(3) var<storage, read> begins: array<u32>;
@group(0) @binding(4) var<storage, read> rows: array<u32>;
@group(0) @binding(5) var<storage, read_write> next_keys: array<u32>;
@group(0) @binding(6) var<storage, read_write> next_rows: array<u32>;
var<workgroup> low: array<vec4u, ${kThreads}>;
var<workgroup> high: array<vec4u, ${kThreads}>;
@compute @workgroup_size(${kThreads}) fn main(
    @builtin(workgroup_id) block: vec3u, @builtin(num_workgroups) blocks: vec3u, @builtin(local_invocation_index) thread: u32) {
  var own: array<vec4u, 2>;
  let first = block.x * ${kBlock} + thread * ${kBlock / kThreads};
  let count = seen[0];
  for (var at = first; at < min(first + ${kBlock / kThreads}, count); at++) {
    let digit = digit_of(keys[at]);
    own[digit >> 3][(digit >> 1) & 3] += 1u << (16 * (digit & 1));
  }
  low[thread] = own[0];
  high[thread] = own[1];
  for (var step = 1u; step < ${kThreads}; step *= 2) {
    workgroupBarrier();
    var other_low = vec4u(0);
    var other_high = vec4u(0);
    if (thread >= step) {
      other_low = low[thread - step];
      other_high = high[thread - step];
    }
    workgroupBarrier();
    low[thread] += other_low;
    high[thread] += other_high;
  }
  var before: array<vec4u, 2>;
  before[0] = low[thread] - own[0];
  before[1] = high[thread] - own[1];
  for (var at = first; at < min(first + ${kBlock / kThreads}, count); at++) {
    let key = keys[at];
    let digit = digit_of(key);
    let shift_of_half = 16 * (digit & 1);
    let rank = (before[digit >> 3][(digit >> 1) & 3] >> shift_of_half) & 0xffffu;
    before[digit >> 3][(digit >> 1) & 3] += 1u << shift_of_half;
    let to = begins[digit * blocks.x + block.x] + rank;
    next_keys[to] = key;
    next_rows[to] = rows[at];
  }
}`;

export const kSplats = `${kView}${kSplat}
@group(0) @binding(1) var<storage, read> seen: array<u32>;
@group(0) @binding(2) var<storage, read> order: array<u32>;
@group(0) @binding(3) var<storage, read> splats: array<Splat>;
struct Corner {
  @builtin(position) position: vec4f,
  @location(0) white: vec2f,
  @location(1) @interpolate(flat) color: vec4f,  // rgb, log2 of alpha in the middle
}
fn color_of(word: u32) -> vec3f {
  return vec3f(vec3u(word, word >> 9, word >> 18) & vec3u(0x1ff)) * exp2(f32(i32(word >> 27) - 24));
}
@vertex fn vertex(@builtin(vertex_index) corner: u32, @builtin(instance_index) batch: u32) -> Corner {
  let rank = batch * ${kBatch} + (corner >> 2);
  if (rank >= seen[0]) { return Corner(vec4f(2, 2, 2, 1), vec2f(), vec4f()); }
  let splat = splats[order[rank]];
  let white = (vec2f(f32(corner & 1), f32((corner >> 1) & 1)) * 2 - 1) * (splat.reach + 0.02);
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

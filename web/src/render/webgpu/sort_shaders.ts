// A stable radix sort of the depths of what is seen. Nothing needs subgroups, nothing comes back to the page, and equal
// depths keep the order of rows in every frame.
import { kBatch } from '../quads';
import { kThreads, kView } from './shared_shaders';

/** Keys that one workgroup sorts at a time: barriers cost more than keys do. */
export const kBlock = 16 * kThreads;
/** Bits of a key that one pass sorts by. */
export const kDigitBits = 4;
export const kDigits = 1 << kDigitBits;

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

// A stable radix sort of the depths of what is seen, least significant digit first. The first pass reads the keys of all
// rows and leaves out what is not seen. Nothing needs subgroups, nothing comes back to the page, and equal depths keep the
// order of rows in every frame.
import { kThreads, kUnseen, kView } from './shared_shaders';

/** Threads of a workgroup that sorts, and keys that each takes, one a round. */
const kSorters = 64;
const kEach = 16;
/** Keys that one workgroup sorts at a time. */
export const kBlock = kEach * kSorters;
/** Bits of a key that one pass sorts by. */
export const kDigitBits = 4;
export const kDigits = 1 << kDigitBits;

/** Of the first pass, all rows; of the others, those that are seen. */
export type Pass = 'all rows' | 'seen rows';

const input = (pass: Pass): string =>
  pass === 'all rows'
    ? `${kView}
const shift = 0u;
fn key_count() -> u32 { return view.rows; }
fn is_seen(key: u32) -> bool { return key != ${kUnseen}u; }
`
    : `
@group(0) @binding(0) var<uniform> shift: u32;
@group(0) @binding(1) var<storage, read> seen: array<u32>;
fn key_count() -> u32 { return seen[0]; }
fn is_seen(key: u32) -> bool { return true; }
`;

const kMain = `@compute @workgroup_size(${kSorters}) fn main(
    @builtin(workgroup_id) block: vec3u, @builtin(num_workgroups) blocks: vec3u, @builtin(local_invocation_index) thread: u32)`;

const kKeys = `
@group(0) @binding(2) var<storage, read> keys: array<u32>;
fn digit_of(key: u32) -> u32 { return (key >> shift) & ${kDigits - 1}u; }
`;

/** How often each digit occurs in each block: [digit][block]. */
export const histogramOf = (pass: Pass): string => `${input(pass)}${kKeys}
@group(0) @binding(3) var<storage, read_write> counts: array<u32>;
var<workgroup> local: array<atomic<u32>, ${kDigits}>;
${kMain} {
  let count = key_count();
  for (var i = 0u; i < ${kEach}; i++) {
    let at = block.x * ${kBlock} + i * ${kSorters} + thread;
    if (at < count && is_seen(keys[at])) { atomicAdd(&local[digit_of(keys[at])], 1u); }
  }
  workgroupBarrier();
  if (thread < ${kDigits}) { counts[thread * blocks.x + block.x] = atomicLoad(&local[thread]); }
}`;

/** After the first pass: how many are seen, and so what is to be dispatched and drawn. */
const kSayWhatIsSeen = `
@group(0) @binding(4) var<storage, read_write> seen_now: array<u32>;  // [1]
@group(0) @binding(5) var<storage, read_write> sort_args: array<u32>; // [3]
@group(0) @binding(6) var<storage, read_write> draw_args: array<u32>; // [4]
fn say(total: u32) {
  seen_now[0] = total;
  sort_args[0] = (total + ${kBlock - 1}) / ${kBlock};
  sort_args[1] = 1;
  sort_args[2] = 1;
  draw_args[0] = 3 * total;
  draw_args[1] = 1;
  draw_args[2] = 0;
  draw_args[3] = 0;
}`;

/**
 * Counts to where each digit of each block begins. By four, since a thread that goes through its part waits for memory at each step.
 */
export const scanCountsOf = (pass: Pass): string => `${input(pass)}
@group(0) @binding(3) var<storage, read_write> counts: array<vec4u>;
${pass === 'all rows' ? kSayWhatIsSeen : 'fn say(total: u32) {}'}
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
@compute @workgroup_size(${kThreads}) fn main(@builtin(local_invocation_index) thread: u32) {
  let n = (key_count() + ${kBlock - 1}) / ${kBlock} * ${kDigits / 4};
  let each = (n + ${kThreads - 1}) / ${kThreads};
  let begin = min(thread * each, n);
  let end = min(begin + each, n);
  var sums = vec4u(0);
  for (var i = begin; i < end; i++) { sums += counts[i]; }
  var at = sum_before(thread, sums.x + sums.y + sums.z + sums.w);
  for (var i = begin; i < end; i++) {
    let count = counts[i];
    let second = at + count.x;
    let third = second + count.y;
    let fourth = third + count.z;
    counts[i] = vec4u(at, second, third, fourth);
    at = fourth + count.w;
  }
  if (thread == 0) { say(partial[${kThreads - 1}]); }
}`;

const rowAt = (pass: Pass): string =>
  pass === 'all rows'
    ? 'fn row_at(at: u32) -> u32 { return at; }'
    : `
@group(0) @binding(4) var<storage, read> rows: array<u32>;
fn row_at(at: u32) -> u32 { return rows[at]; }`;

const kWords = kBlock / 32;

/**
 * Every key to its place by this digit; those with the same digit keep their order. A key's rank in its block is how many bits
 * are set before its own, of those of the block's keys that have its digit. What workgroups share is kept small: it is
 * cleared first, which a software device does once for every few threads.
 */
export const reorderOf = (pass: Pass): string => `${input(pass)}${kKeys}
@group(0) @binding(3) var<storage, read> begins: array<u32>;
${rowAt(pass)}
@group(0) @binding(5) var<storage, read_write> next_keys: array<u32>;
@group(0) @binding(6) var<storage, read_write> next_rows: array<u32>;
var<workgroup> bits: array<atomic<u32>, ${kDigits * kWords}>;       // [digit][word]
var<workgroup> bits_before: array<u32, ${(kDigits * kWords) / 2}>;  // [digit][word], two a word
${kMain} {
  let count = key_count();
  let first = block.x * ${kBlock} + thread;
  let bit = 1u << (thread & 31);
  for (var i = 0u; i < ${kEach}; i++) {
    let at = first + i * ${kSorters};
    if (at < count && is_seen(keys[at])) { atomicOr(&bits[digit_of(keys[at]) * ${kWords} + (i * ${kSorters} + thread) / 32], bit); }
  }
  workgroupBarrier();
  if (thread < ${kDigits}) {
    var sum = 0u;
    for (var word = thread * ${kWords}; word < (thread + 1) * ${kWords}; word += 2) {
      let next = sum + countOneBits(atomicLoad(&bits[word]));
      bits_before[word / 2] = sum | (next << 16);
      sum = next + countOneBits(atomicLoad(&bits[word + 1]));
    }
  }
  workgroupBarrier();
  for (var i = 0u; i < ${kEach}; i++) {
    let at = first + i * ${kSorters};
    if (at >= count || !is_seen(keys[at])) { continue; }
    let key = keys[at];
    let digit = digit_of(key);
    let word = digit * ${kWords} + (i * ${kSorters} + thread) / 32;
    let to = begins[digit * blocks.x + block.x] + ((bits_before[word / 2] >> (16 * (word & 1))) & 0xffff)
      + countOneBits(atomicLoad(&bits[word]) & (bit - 1));
    next_keys[to] = key;
    next_rows[to] = row_at(at);
  }
}`;

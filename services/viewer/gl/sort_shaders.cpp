#include "viewer/gl/shaders.h"

// Nothing needs subgroups, and nothing comes back to the host.
namespace splatbus::viewer::gl {
static_assert(kThreads == 256 && kBlock == 16 * kThreads && kBatch == 128 && kDigits == 32);

const char* const kCountSeenText = R"glsl(#version 450 core
)glsl"
#include "viewer/gl/sort_head_glsl.inc"
                                   R"glsl(
layout(std430, binding = 0) buffer GroupCounts { uint group_counts[]; };
layout(std430, binding = 1) writeonly buffer Seen {
  Counted seen;
  uint draw[5];
  uint row_groups[3];
};
layout(location = 0) uniform uint uRows;
void main() {
  uint thread = gl_LocalInvocationIndex;
  uint groups = (uRows + kThreads - 1u) / kThreads;
  uint each = (groups + kThreads - 1u) / kThreads;
  uint begin = min(thread * each, groups), end = min(begin + each, groups);
  uint sum = 0u;
  for (uint i = begin; i < end; ++i) sum += group_counts[i];
  uint at = sumBefore(thread, sum);
  for (uint i = begin; i < end; ++i) {
    uint count = group_counts[i];
    group_counts[i] = at;
    at += count;
  }
  if (thread != 0u) return;
  uint total = partial[kThreads - 1u];
  seen.rows = total;
  seen.groups = uint[3]((total + kBlock - 1u) / kBlock, 1u, 1u);
  draw = uint[5](6u * kBatch, (total + kBatch - 1u) / kBatch, 0u, 0u, 0u);
  row_groups = uint[3]((total + kThreads - 1u) / kThreads, 1u, 1u);
}
)glsl";

const char* const kCloseUpText = R"glsl(#version 450 core
)glsl"
#include "viewer/gl/sort_head_glsl.inc"
                                 R"glsl(
layout(std430, binding = 0) readonly buffer Keys { uint keys[]; };
layout(std430, binding = 1) readonly buffer GroupBegins { uint group_begins[]; };
layout(std430, binding = 2) writeonly buffer SeenKeys { uint seen_keys[]; };
layout(std430, binding = 3) writeonly buffer SeenRowNumbers { uint seen_rows[]; };
layout(location = 0) uniform uint uRows;
void main() {
  uint row = gl_GlobalInvocationID.x;
  uint key = 0xffffffffu;
  if (row < uRows) key = keys[row];
  bool is_seen = key != 0xffffffffu;
  uint at = group_begins[gl_WorkGroupID.x] + sumBefore(gl_LocalInvocationIndex, is_seen ? 1u : 0u);
  if (!is_seen) return;
  seen_keys[at] = key;
  seen_rows[at] = row;
}
)glsl";

const char* const kHistogramText = R"glsl(#version 450 core
)glsl"
#include "viewer/gl/sort_head_glsl.inc"
                                   R"glsl(
layout(std430, binding = 0) readonly buffer CountedRows { Counted counted; };
layout(std430, binding = 1) readonly buffer Keys { uint keys[]; };
layout(std430, binding = 2) writeonly buffer Counts { uint counts[]; };  // [digit][block]
layout(location = 0) uniform uint uShift;
shared uint digits[kDigits];
void main() {
  uint thread = gl_LocalInvocationIndex;
  if (thread < kDigits) digits[thread] = 0u;
  synchronise();
  uint first = gl_WorkGroupID.x * kBlock + thread;
  for (uint i = 0u; i < kEach; ++i) {
    uint at = first + i * kThreads;
    if (at < counted.rows) atomicAdd(digits[(keys[at] >> uShift) & (kDigits - 1u)], 1u);
  }
  synchronise();
  if (thread < kDigits) counts[thread * gl_NumWorkGroups.x + gl_WorkGroupID.x] = digits[thread];
}
)glsl";

// By four, since a thread that goes through its part waits for memory at each step.
const char* const kScanCountsText = R"glsl(#version 450 core
)glsl"
#include "viewer/gl/sort_head_glsl.inc"
                                    R"glsl(
layout(std430, binding = 0) readonly buffer CountedRows { Counted counted; };
layout(std430, binding = 1) buffer Counts { uvec4 counts[]; };
void main() {
  uint thread = gl_LocalInvocationIndex;
  uint n = counted.groups[0] * (kDigits / 4u);
  uint each = (n + kThreads - 1u) / kThreads;
  uint begin = min(thread * each, n), end = min(begin + each, n);
  uvec4 sums = uvec4(0u);
  for (uint i = begin; i < end; ++i) sums += counts[i];
  uint at = sumBefore(thread, sums.x + sums.y + sums.z + sums.w);
  for (uint i = begin; i < end; ++i) {
    uvec4 count = counts[i];
    uint second = at + count.x, third = second + count.y, fourth = third + count.z;
    counts[i] = uvec4(at, second, third, fourth);
    at = fourth + count.w;
  }
}
)glsl";

// A thread counts sixteen keys in a column of its own, two digits a word: 4096 keys a block fit into 16 bits. The
// columns' sums in front of each thread are its keys' ranks. Columns are padded, or threads of one digit would meet in
// the same bank.
const char* const kReorderText = R"glsl(#version 450 core
)glsl"
#include "viewer/gl/sort_head_glsl.inc"
                                 R"glsl(
layout(std430, binding = 0) readonly buffer CountedRows { Counted counted; };
layout(std430, binding = 1) readonly buffer Keys { uint keys[]; };
layout(std430, binding = 2) readonly buffer Begins { uint begins[]; };  // [digit][block]
layout(std430, binding = 3) readonly buffer Rows { uint rows[]; };
layout(std430, binding = 4) writeonly buffer NextKeys { uint next_keys[]; };
layout(std430, binding = 5) writeonly buffer NextRows { uint next_rows[]; };
layout(location = 0) uniform uint uShift;
const uint kPairs = kDigits / 2u;
const uint kPadded = kThreads + kThreads / 16u;
shared uint counters[kPairs * kPadded];
uint slot(uint pair, uint thread) { return pair * kPadded + thread + (thread >> 4u); }
void main() {
  uint thread = gl_LocalInvocationIndex;
  uint first = gl_WorkGroupID.x * kBlock + thread * kEach;
  uint end = min(first + kEach, counted.rows);
  for (uint pair = 0u; pair < kPairs; ++pair) counters[slot(pair, thread)] = 0u;
  for (uint at = first; at < end; ++at) {
    uint digit = (keys[at] >> uShift) & (kDigits - 1u);
    counters[slot(digit >> 1u, thread)] += 1u << (16u * (digit & 1u));
  }
  synchronise();
  // Sixteen threads a pair of digits, sixteen columns each.
  uint pair = thread >> 4u, segment = thread & 15u, sum = 0u;
  for (uint i = 0u; i < 16u; ++i) sum += counters[slot(pair, 16u * segment + i)];
  partial[thread] = sum;
  synchronise();
  uint before = 0u;
  for (uint k = 0u; k < segment; ++k) before += partial[16u * pair + k];
  for (uint i = 0u; i < 16u; ++i) {
    uint at = slot(pair, 16u * segment + i);
    uint count = counters[at];
    counters[at] = before;
    before += count;
  }
  synchronise();
  for (uint at = first; at < end; ++at) {
    uint key = keys[at];
    uint digit = (key >> uShift) & (kDigits - 1u), half_shift = 16u * (digit & 1u);
    uint counter = slot(digit >> 1u, thread);
    uint rank = (counters[counter] >> half_shift) & 0xffffu;
    counters[counter] += 1u << half_shift;
    uint to = begins[digit * gl_NumWorkGroups.x + gl_WorkGroupID.x] + rank;
    next_keys[to] = key;
    next_rows[to] = rows[at];
  }
}
)glsl";

}  // namespace splatbus::viewer::gl

#include "viewer/gl/shaders.h"

// Nothing needs subgroups, and barriers are where all threads of a group come.
namespace splatbus::viewer::gl {
static_assert(kThreads == 256 && kTileSide == 16 && kMostCounted == 0xffffff);

const char* const kCountTilesText = R"glsl(#version 450 core
)glsl"
#include "viewer/gl/sort_head_glsl.inc"
#include "viewer/gl/splat_glsl.inc"
#include "viewer/gl/tile_head_glsl.inc"
                                    R"glsl(
layout(std430, binding = 0) readonly buffer Seen { uint seen_rows; };
layout(std430, binding = 1) readonly buffer Order { uint order[]; };
layout(std430, binding = 2) readonly buffer Splats { uvec4 splats[]; };
layout(std430, binding = 3) writeonly buffer TileCounts { uint tile_counts[]; };  // nearest first
layout(std430, binding = 4) writeonly buffer GroupCounts { uint group_counts[]; };
layout(location = 0) uniform uvec2 uPixels;
shared uint sum;
void main() {
  if (gl_LocalInvocationIndex == 0u) sum = 0u;
  synchronise();
  uint rank = gl_GlobalInvocationID.x;
  if (rank < seen_rows) {
    uint row = order[seen_rows - 1u - rank];
    Splat splat = splatAt(splats[2u * row], splats[2u * row + 1u]);
    float radius = whiteRadiusOf(splat);
    uvec2 rows = tileRowsOf(splat, radius, uPixels);
    uint count = 0u;
    for (uint y = rows.x; y < rows.y; ++y) {
      uvec2 columns = tilesOf(splat, radius, uPixels, y);
      count += columns.y - columns.x;
    }
    tile_counts[rank] = count;
    atomicAdd(sum, count);
  }
  synchronise();
  if (gl_LocalInvocationIndex == 0u) group_counts[gl_WorkGroupID.x] = sum;
}
)glsl";

// Each thread's sum stops at kMostCounted, so that none overflows: that is more than there is room for.
const char* const kCountPairsText = R"glsl(#version 450 core
)glsl"
#include "viewer/gl/sort_head_glsl.inc"
                                    R"glsl(
layout(std430, binding = 0) buffer GroupCounts { uint group_counts[]; };
layout(std430, binding = 1) buffer Seen {
  Counted seen;
  uint draw[5];
  uint seen_groups[3];
};
layout(std430, binding = 2) writeonly buffer Pairs {
  Counted pairs;
  uint row_groups[3];
  uint wanted;
};
layout(std430, binding = 3) writeonly buffer Ranges { uvec2 ranges[]; };
layout(location = 1) uniform uvec2 uTiles;
layout(location = 2) uniform uint uCapacity;
const uint kMostCounted = 0xffffffu;
void main() {
  uint thread = gl_LocalInvocationIndex;
  uint groups = seen_groups[0];
  uint each = (groups + kThreads - 1u) / kThreads;
  uint begin = min(thread * each, groups), end = min(begin + each, groups);
  uint sum = 0u;
  for (uint i = begin; i < end; ++i) sum = min(sum + group_counts[i], kMostCounted);
  uint at = sumBefore(thread, sum);
  for (uint i = begin; i < end; ++i) {
    uint count = group_counts[i];
    group_counts[i] = at;
    at += count;
  }
  for (uint i = thread; i <= uTiles.x * uTiles.y; i += kThreads) ranges[i] = uvec2(0u);
  if (thread != 0u) return;
  uint total = partial[kThreads - 1u];
  bool fits = total <= uCapacity;
  wanted = total;
  pairs.rows = fits ? total : 0u;
  pairs.groups = uint[3](fits ? (total + kBlock - 1u) / kBlock : 0u, 1u, 1u);
  row_groups = uint[3](fits ? groups : 0u, 1u, 1u);
  if (fits) draw[1] = 0u;
}
)glsl";

// A tile more or less than were counted, where the compiler has rounded otherwise, does no harm: it is left out, or one
// behind the last takes its place.
const char* const kPairText = R"glsl(#version 450 core
)glsl"
#include "viewer/gl/sort_head_glsl.inc"
#include "viewer/gl/splat_glsl.inc"
#include "viewer/gl/tile_head_glsl.inc"
                              R"glsl(
layout(std430, binding = 0) readonly buffer Seen { uint seen_rows; };
layout(std430, binding = 1) readonly buffer Order { uint order[]; };
layout(std430, binding = 2) readonly buffer Splats { uvec4 splats[]; };
layout(std430, binding = 3) readonly buffer TileCounts { uint tile_counts[]; };
layout(std430, binding = 4) readonly buffer GroupBegins { uint group_begins[]; };
layout(std430, binding = 5) writeonly buffer PairTiles { uint pair_tiles[]; };
layout(std430, binding = 6) writeonly buffer PairRows { uint pair_rows[]; };
layout(location = 0) uniform uvec2 uPixels;
layout(location = 1) uniform uvec2 uTiles;
void main() {
  uint rank = gl_GlobalInvocationID.x;
  uint left = rank < seen_rows ? tile_counts[rank] : 0u;
  uint at = group_begins[gl_WorkGroupID.x] + sumBefore(gl_LocalInvocationIndex, left);
  if (left == 0u) return;
  uint row = order[seen_rows - 1u - rank];
  Splat splat = splatAt(splats[2u * row], splats[2u * row + 1u]);
  float radius = whiteRadiusOf(splat);
  uvec2 rows = tileRowsOf(splat, radius, uPixels);
  for (uint y = rows.x; y < rows.y; ++y) {
    uvec2 columns = tilesOf(splat, radius, uPixels, y);
    for (uint x = columns.x; x < columns.y && left > 0u; ++x, ++at, --left) {
      pair_tiles[at] = y * uTiles.x + x;
      pair_rows[at] = row;
    }
  }
  for (; left > 0u; ++at, --left) {
    pair_tiles[at] = uTiles.x * uTiles.y;
    pair_rows[at] = row;
  }
}
)glsl";

const char* const kRangesText = R"glsl(#version 450 core
)glsl"
#include "viewer/gl/sort_head_glsl.inc"
                                R"glsl(
layout(std430, binding = 0) readonly buffer CountedRows { Counted counted; };
layout(std430, binding = 1) readonly buffer PairTiles { uint pair_tiles[]; };
layout(std430, binding = 2) writeonly buffer Ranges { uint ranges[]; };  // [tile][begin, end]
void main() {
  uint first = gl_WorkGroupID.x * kBlock + gl_LocalInvocationIndex;
  for (uint i = 0u; i < kEach; ++i) {
    uint at = first + i * kThreads;
    if (at >= counted.rows) break;
    uint tile = pair_tiles[at];
    if (at == 0u || pair_tiles[at - 1u] != tile) ranges[2u * tile] = at;
    if (at + 1u == counted.rows || pair_tiles[at + 1u] != tile) ranges[2u * tile + 1u] = at + 1u;
  }
}
)glsl";

// A group takes 256 splats at a time into shared memory. Each thread loads one and marks which of the tile's blocks of
// 8 x 4 pixels it touches; then the 32 threads of a block visit those alone that touch theirs, and stop where nothing
// behind would show, as the CPU rasteriser does.
const char* const kBlendText = R"glsl(#version 450 core
)glsl"
#include "viewer/gl/sort_head_glsl.inc"
#include "viewer/gl/splat_glsl.inc"
#include "viewer/gl/tile_head_glsl.inc"
                               R"glsl(
layout(std430, binding = 0) readonly buffer Ranges { uvec2 ranges[]; };
layout(std430, binding = 1) readonly buffer PairRows { uint pair_rows[]; };
layout(std430, binding = 2) readonly buffer Splats { uvec4 splats[]; };
layout(rgba16f, binding = 0) writeonly uniform image2D uPicture;
layout(location = 0) uniform uvec2 uPixels;
const float kLeastTransmittance = 1e-4;
const uint kBlocks = 8u;  // two a row
const uint kWords = kThreads / 32u;
shared vec4 middles[kThreads];  // centre; the first white unit of x and of y
shared uvec4 rests[kThreads];   // the second white unit of y, log2 of alpha, color
shared uint touching[kBlocks * kWords];  // bits by splat
shared uint any_left;

void load(uint slot, uint row, uvec2 corner) {
  uvec4 low = splats[2u * row], high = splats[2u * row + 1u];
  Splat splat = splatAt(low, high);
  vec3 root = splat.root / kWhiteScale;
  middles[slot] = vec4(splat.centre, 1.0 / root.x, -root.y / (root.x * root.z));
  rests[slot] = uvec4(floatBitsToUint(1.0 / root.z), high.yzw);
  float radius = whiteRadiusOf(splat);
  vec2 height = heightOf(splat, radius);
  for (uint y = 0u; y < kBlocks / 2u; ++y) {
    float top = float(corner.y + 4u * y) + 0.5;
    if (height.x > top + 3.0 || height.y < top) continue;
    vec2 width = widthOf(splat, radius, vec2(top, top + 3.0));
    for (uint x = 0u; x < 2u; ++x) {
      float left = float(corner.x + 8u * x) + 0.5;
      if (width.x > left + 7.0 || width.y < left) continue;
      atomicOr(touching[(2u * y + x) * kWords + (slot >> 5u)], 1u << (slot & 31u));
    }
  }
}

void main() {
  uint thread = gl_LocalInvocationIndex, block = thread >> 5u;
  uvec2 corner = kTileSide * gl_WorkGroupID.xy;
  uvec2 pixel = corner + uvec2(8u * (block & 1u) + (thread & 7u), 4u * (block >> 1u) + ((thread >> 3u) & 3u));
  vec2 middle = vec2(pixel) + 0.5;
  bool shows = all(lessThan(pixel, uPixels));
  float transmittance = shows ? 1.0 : 0.0;
  vec3 color = vec3(0.0);
  uvec2 range = ranges[gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x];
  for (uint begin = range.x; begin < range.y; begin += kThreads) {
    if (thread < kBlocks * kWords) touching[thread] = 0u;
    if (thread == 0u) any_left = 0u;
    synchronise();
    if (transmittance >= kLeastTransmittance) any_left = 1u;
    if (begin + thread < range.y) load(thread, pair_rows[begin + thread], corner);
    synchronise();
    if (any_left == 0u) break;
    for (uint word = 0u; word < kWords; ++word) {
      uint left = touching[block * kWords + word];
      while (left != 0u && transmittance >= kLeastTransmittance) {
        uint slot = 32u * word + uint(findLSB(left));
        left &= left - 1u;
        vec4 geometry = middles[slot];
        uvec4 rest = rests[slot];
        vec2 from = middle - geometry.xy;
        vec2 white = vec2(dot(from, geometry.zw), from.y * uintBitsToFloat(rest.x));
        float log2Alpha = uintBitsToFloat(rest.y) - dot(white, white);
        if (log2Alpha < -7.9943534) continue;
        float alpha = min(exp2(log2Alpha), 0.999);
        color += transmittance * alpha * vec3(unpackHalf2x16(rest.z), unpackHalf2x16(rest.w).x);
        transmittance -= transmittance * alpha;
      }
    }
    synchronise();
  }
  if (shows) imageStore(uPicture, ivec2(pixel.x, uPixels.y - 1u - pixel.y), vec4(color, 1.0 - transmittance));
}
)glsl";

}  // namespace splatbus::viewer::gl

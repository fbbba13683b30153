#include <cuda_bf16.h>

#include <algorithm>

#include "raster/cuda/blend.cuh"

namespace splatbus::raster::cuda {
namespace {

constexpr int kDepthPlane = 6;  // behind colour and albedo
constexpr int kColumns = 8;     // Gaussians summed by one round of matrix products

/// A warp's Gaussians whose gradients wait to be summed over the patch's pixels: for each pixel s = dL/d(ln alpha) and
/// the blending weight. The sums are matrix products on the tensor cores, (what multiplies s and the weight) [16][32
/// pixels] times (s and weight) [32 pixels][8 Gaussians], so that no shuffles are needed.
struct alignas(16) Columns {
  float2 values[kColumns]
               [kLanes];    // bits of (s as two bfloat16, weight as tf32); odd columns have pixel bit 3 inverted
  float2 center[kColumns];  // of the Gaussian, from the patch's centre
};
static_assert(sizeof(Columns::values) >= kColumns * 17 * sizeof(float));

/// s as the sum of two bfloat16: 16 bits of mantissa.
__device__ inline std::uint32_t split_bfloat16(float s) {
  const float high = __uint_as_float(__float_as_uint(s) & 0xFFFF0000U);
  const __nv_bfloat162 pair = __floats2bfloat162_rn(s - high, high);
  std::uint32_t bits;
  memcpy(&bits, &pair, sizeof(bits));
  return bits;
}

__device__ inline std::uint32_t tf32(float value) {
  std::uint32_t bits;
  asm("cvt.rna.tf32.f32 %0, %1;" : "=r"(bits) : "f"(value));
  return bits;
}

/// Rows 0 to 7 of d [16][8] += a [8][16] b [16][8]; each word of `a` and `b` holds two neighbours of the inner index.
__device__ inline void multiply_bfloat16(float (&d)[4], std::uint32_t a0, std::uint32_t a2, std::uint32_t b0,
                                         std::uint32_t b1) {
  asm("mma.sync.aligned.m16n8k16.row.col.f32.bf16.bf16.f32 {%0,%1,%2,%3}, {%4,%5,%6,%5}, {%7,%8}, {%0,%1,%2,%3};"
      : "+f"(d[0]), "+f"(d[1]), "+f"(d[2]), "+f"(d[3])
      : "r"(a0), "r"(0U), "r"(a2), "r"(b0), "r"(b1));
}

/// Rows 8 to 15 of d [16][8] += a [8][8] b [8][8].
__device__ inline void multiply_tf32(float (&d)[4], std::uint32_t a1, std::uint32_t a3, std::uint32_t b0,
                                     std::uint32_t b1) {
  asm("mma.sync.aligned.m16n8k8.row.col.f32.tf32.tf32.f32 {%0,%1,%2,%3}, {%5,%4,%5,%6}, {%7,%8}, {%0,%1,%2,%3};"
      : "+f"(d[0]), "+f"(d[1]), "+f"(d[2]), "+f"(d[3])
      : "r"(a1), "r"(0U), "r"(a3), "r"(b0), "r"(b1));
}

__device__ inline float reciprocal(float x) {
  float y;
  asm("rcp.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x));
  return y;
}

/// The left factors, in shared memory of a warp. A lane's share is row lane / 4, and the pixels 8 k + 2 (lane % 4) and
/// the next, k = 0 to 3; [k / 2][lane] holds those of k and of k + 1.
struct Factors {
  uint4 moments[kPatchHeight / 2][kLanes];   // row of 1, x, y, x^2, x y, y^2, pixels from the patch's centre
  uint4 gradient[kPatchHeight / 2][kLanes];  // row of dL/d(red, green, blue, albedo, depth)

  template <int kPlanes>
  __device__ void set(const float (&g)[kPlanes]) {
    const int lane = threadIdx.x & (kLanes - 1), row = lane >> 2, quad = lane & 3;
#pragma unroll
    for (int half = 0; half < kPatchHeight / 2; ++half) {
      std::uint32_t moment[4], of_gradient[4];
#pragma unroll
      for (int part = 0; part < 4; ++part) {
        const int column = 2 * quad + part % 2, line = 2 * half + part / 2;
        const float x = column - 0.5F * (kPatchWidth - 1), y = line - 0.5F * (kPatchHeight - 1);
        const float rows[8] = {1.0F, x, y, x * x, x * y, y * y, 0.0F, 0.0F};
        float value = 0.0F, gradient_here = 0.0F;
#pragma unroll
        for (int r = 0; r < 8; ++r) value = row == r ? rows[r] : value;
        const __nv_bfloat162 twice = __float2bfloat162_rn(value);
        memcpy(&moment[part], &twice, sizeof(twice));
#pragma unroll
        for (int plane = 0; plane < kPlanes; ++plane) {
          const float of_pixel = __shfl_sync(kAllLanes, g[plane], kPatchWidth * line + column);
          gradient_here = row == plane ? of_pixel : gradient_here;
        }
        of_gradient[part] = tf32(gradient_here);
      }
      moments[half][lane] = make_uint4(moment[0], moment[1], moment[2], moment[3]);
      gradient[half][lane] = make_uint4(of_gradient[0], of_gradient[1], of_gradient[2], of_gradient[3]);
    }
  }
};

/// Whose column lane / 4 is.
struct Owner {
  float x, y;  // centre, pixels from the patch's centre
  std::uint32_t row;
};

/// Sums the first `count` columns and adds them to their projected Gaussians.
template <bool kDepth>
__device__ void flush(Columns& columns, int count, const Owner& c, const Factors& factors, const WorkspaceView& w,
                      int view) {
  const int lane = threadIdx.x & (kLanes - 1), column = lane >> 2, quad = lane & 3;
  __syncwarp();
  float d[4] = {};
  const auto* row = reinterpret_cast<const float4*>(columns.values[column]);
#pragma unroll
  for (int half = 0; half < kPatchHeight / 2; ++half) {
    const uint4 m = factors.moments[half][lane], g = factors.gradient[half][lane];
    const float4 v = row[(8 * half + quad) ^ ((column & 1) << 2)], u = row[(8 * half + 4 + quad) ^ ((column & 1) << 2)];
    multiply_bfloat16(d, m.x, m.y, __float_as_uint(v.x), __float_as_uint(v.z));
    multiply_tf32(d, g.x, g.y, __float_as_uint(v.y), __float_as_uint(v.w));
    multiply_bfloat16(d, m.z, m.w, __float_as_uint(u.x), __float_as_uint(u.z));
    multiply_tf32(d, g.z, g.w, __float_as_uint(u.y), __float_as_uint(u.w));
  }
  __syncwarp();
  // d[0], d[1]: row lane / 4 of columns 2 quad and the next; d[2], d[3]: eight rows further down.
  constexpr int kStride = 17;
  auto* sums = reinterpret_cast<float*>(columns.values);
  sums[2 * quad * kStride + column] = d[0];
  sums[(2 * quad + 1) * kStride + column] = d[1];
  sums[2 * quad * kStride + 8 + column] = d[2];
  sums[(2 * quad + 1) * kStride + 8 + column] = d[3];
  __syncwarp();
  if (column < count) {
    const float* m = sums + column * kStride;
    const std::size_t at = static_cast<std::size_t>(view) * w.rows + c.row;
    float4 out;
    if (quad == 0) {
      const float s_x = m[1] - c.x * m[0], s_y = m[2] - c.y * m[0];
      out = make_float4(s_x, s_y, m[3] - c.x * (m[1] + s_x), m[4] - c.x * m[2] - c.y * s_x);
    } else if (quad == 1) {
      const float s_y = m[2] - c.y * m[0];
      out = make_float4(m[5] - c.y * (m[2] + s_y), m[0], m[8], m[9]);
    } else {
      out = make_float4(m[10], m[11], m[12], m[13]);
    }
    if (quad < 3) {
      atomicAdd(reinterpret_cast<float4*>(w.projected_gradient + at * kGradientFloats) + quad, out);
    } else {
      w.projected_visible[at] = 1;
      if constexpr (kDepth) {
        if (w.projected_depth_gradient != nullptr) atomicAdd(w.projected_depth_gradient + at, m[14]);
      }
    }
  }
  __syncwarp();
}

/// What the segments of a warp share.
template <bool kExtra>
struct Scratch {
  Staged<kExtra> staged;
  Columns columns;
  Factors factors;
};

/// Where a segment begins, and a pixel's state before it.
struct Start {
  std::uint32_t patch = 0, position = 0;
  float4 color = {1.0F, 0.0F, 0.0F, 0.0F};  // transmittance, red, green, blue
  float4 extra = {0.0F, 0.0F, 0.0F, 0.0F};  // albedo, depth
};

/// The first segments of all patches come first.
template <bool kAlbedo, bool kDepth>
__device__ Start start_of(const WorkspaceView& w, std::uint32_t item, std::uint32_t patches) {
  Start start;
  start.patch = item;
  if (item < patches) return start;
  const std::uint32_t segment = item - patches;
  const uint2 place = w.segments[segment];
  const std::size_t state = kLanes * static_cast<std::size_t>(segment) + (threadIdx.x & (kLanes - 1));
  start.patch = place.x;
  start.position = place.y;
  start.color = w.segment_color[state];
  if constexpr (kAlbedo) {
    start.extra = w.segment_extra[state];
  } else if constexpr (kDepth) {
    if (w.depth_gradient != nullptr) start.extra = w.segment_extra[state];
  }
  return start;
}

/// One segment, front to back, as the forward pass and with its tests, so that both visit the same Gaussians. With G
/// the part of dL/dC . C that is blended so far and `total` all of it, dL/d(ln alpha) = weight (c . g) - alpha (total -
/// G) / (1 - alpha).
template <bool kAlbedo, bool kDepth>
__device__ void blend_segment(const DeviceGaussians& gaussians, const WorkspaceView& w, const Start& start,
                              Scratch<kAlbedo || kDepth>& scratch) {
  const Pixel pixel = locate_patch(w, start.patch);
  const int lane = threadIdx.x & (kLanes - 1);
  Staged<kAlbedo || kDepth>& staged = scratch.staged;
  Columns& columns = scratch.columns;
  PatchStream<kAlbedo, kDepth> stream(gaussians, w, pixel, staged, start.position);
  constexpr int kPlanes = kDepth ? kDepthPlane + 1 : (kAlbedo ? 6 : 3);
  float g[kPlanes] = {}, rest_of_total = 0.0F;
  if (pixel.inside) {
    const std::size_t pixels = static_cast<std::size_t>(w.width) * w.height;
    const std::size_t at = 3 * pixels * pixel.view + pixel.at;
    const float blended[3] = {start.color.y, start.color.z, start.color.w};
    for (int c = 0; c < 3; ++c) {
      g[c] = w.color_gradient[at + c * pixels];
      rest_of_total += g[c] * (w.color[at + c * pixels] - blended[c]);
    }
    if constexpr (kAlbedo) {
      const float albedo_blended[3] = {start.extra.x, start.extra.y, start.extra.z};
      for (int c = 0; c < 3; ++c) {
        g[3 + c] = w.albedo_gradient[at + c * pixels];
        rest_of_total += g[3 + c] * (w.albedo[at + c * pixels] - albedo_blended[c]);
      }
    }
    if constexpr (kDepth) {
      const std::size_t here = pixels * pixel.view + pixel.at;
      // Alpha is what is not left of the transmittance: like a background of -1.
      rest_of_total -= w.alpha_gradient[here] * w.transmittance[here];
      if (w.depth_gradient != nullptr) {
        g[kDepthPlane] = w.depth_gradient[here];
        rest_of_total += g[kDepthPlane] * (w.depth[here] - start.extra.w);
      }
    }
  }
  Factors& factors = scratch.factors;
  factors.set(g);
  const float center_x = pixel.x0 + 0.5F * kPatchWidth, center_y = pixel.y0 + 0.5F * kPatchHeight;
  float transmittance = pixel.inside ? start.color.x : 0.0F;
  int column = 0;
  Owner owner{};
  for (int group = 0; group < kSegmentGroups; ++group) {
    const int count = stream.advance();
    if (count == 0) break;
    for (int j = 0; j < count; ++j) {
      const float4 shape = staged.shape[j], rest = staged.rest[j];
      const float log2_alpha = log2_alpha_at(shape, rest, pixel);
      const bool taken = log2_alpha >= kLog2AlphaMin && transmittance >= kTransmittanceMin;
      if (!__any_sync(kAllLanes, taken)) continue;
      const float unclamped = exp2_approximate(log2_alpha), alpha = fminf(kAlphaMax, unclamped);
      const float weight = taken ? __fmul_rn(alpha, transmittance) : 0.0F;
      transmittance = __fsub_rn(transmittance, weight);
      const float2 tail = staged.tail[j];
      float along = g[0] * rest.z + g[1] * rest.w + g[2] * tail.x;
      if constexpr (kAlbedo) {
        const float4 a = staged.extra[j];
        along += g[3] * a.x + g[4] * a.y + g[5] * a.z;
      }
      if constexpr (kDepth) along += g[kDepthPlane] * staged.extra[j].w;
      rest_of_total -= weight * along;
      if (is_resting(shape)) continue;
      const bool moves = taken && unclamped <= kAlphaMax;
      const float s = moves ? weight * along - alpha * rest_of_total * reciprocal(1.0F - alpha) : 0.0F;
      columns.values[column][lane ^ ((column & 1) << 3)] =
          make_float2(__uint_as_float(split_bfloat16(s)), __uint_as_float(tf32(weight)));
      if (lane / 4 == column) owner = {shape.x - center_x, shape.y - center_y, __float_as_uint(tail.y)};
      if (++column == kColumns) {
        flush<kDepth>(columns, kColumns, owner, factors, w, pixel.view);
        column = 0;
      }
    }
    if (__all_sync(kAllLanes, transmittance < kTransmittanceMin)) break;
  }
  if (column > 0) flush<kDepth>(columns, column, owner, factors, w, pixel.view);
}

/// Each warp takes segments in turn. kDepth: gradients through alpha too, and through depth where there are any.
template <bool kAlbedo, bool kDepth>
__global__ void __launch_bounds__(kBlendThreads, 6) blend_backward_kernel(DeviceGaussians gaussians, WorkspaceView w) {
  __shared__ Scratch<kAlbedo || kDepth> scratch[kBlendWarps];
  if (is_incomplete(w)) return;
  const std::uint32_t patches = w.tiles_x * w.tiles_y * w.batch * kPatches;
  const std::uint32_t count = patches + min(w.counts->segments, w.segment_capacity);
  const unsigned warp = threadIdx.x / kLanes;
  for (std::uint32_t k = blockIdx.x * kBlendWarps + warp; k < count; k += gridDim.x * kBlendWarps) {
    if (w.segment_trains != nullptr && w.segment_trains[k] == 0) continue;
    blend_segment<kAlbedo, kDepth>(gaussians, w, start_of<kAlbedo, kDepth>(w, k, patches), scratch[warp]);
    __syncwarp();
  }
}

/// As many blocks as keep the device busy to the end, however many segments there turn out to be.
unsigned backward_blocks(const WorkspaceView& w) {
  static const int processors = [] {
    int device = 0, count = 0;
    check(cudaGetDevice(&device), "asking for the device");
    check(cudaDeviceGetAttribute(&count, cudaDevAttrMultiProcessorCount, device), "asking for multiprocessors");
    return count;
  }();
  constexpr unsigned kBlocksPerProcessor = 48;
  const unsigned needed = static_cast<unsigned>(blend_blocks(w)) + (w.segment_capacity + kBlendWarps - 1) / kBlendWarps;
  return std::min(needed, kBlocksPerProcessor * static_cast<unsigned>(processors));
}

}  // namespace

void launch_blend_backward(const DeviceGaussians& gaussians, const WorkspaceView& workspace, cudaStream_t stream) {
  if (blend_blocks(workspace) == 0) return;
  const unsigned blocks = backward_blocks(workspace);
  with_planes(workspace.albedo != nullptr, workspace.alpha_gradient != nullptr, [&](auto albedo, auto depth) {
    blend_backward_kernel<albedo(), depth()><<<blocks, kBlendThreads, 0, stream>>>(gaussians, workspace);
  });
  check(cudaGetLastError(), "backward blending");
}

}  // namespace splatbus::raster::cuda

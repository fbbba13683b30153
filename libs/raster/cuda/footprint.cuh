#pragma once

#include "raster/cuda/projection_math.cuh"
#include "raster/cuda/workspace.h"

namespace splatbus::raster::cuda {

constexpr float kAlphaMin = 1.0F / 255.0F;
constexpr float kAlphaMax = 0.999F;
constexpr float kTransmittanceMin = 1e-4F;
constexpr float kMargin = 1e-2F;  // pixels, for rounding
constexpr float kLog2AlphaMin = -7.994353436858858F;

/// The ellipse u^2 + v^2 <= level in which a Gaussian's alpha reaches 1/255, and the patches of tiles that have a pixel
/// centre in it.
struct Footprint {
  float x, y;  // centre, pixels
  ConicFactor conic;
  float level, inv_uxx;
  float half_y;           // of its bounding box
  float rightmost_dy;     // of its rightmost point
  int row_low, row_high;  // tile rows, half open

  /// False when it holds no pixel centre of the image.
  __device__ bool set(float center_x, float center_y, const Projection& p, const ConicFactor& u, float log2_alpha,
                      const WorkspaceView& w) {
    x = center_x;
    y = center_y;
    conic = u;
    level = log2_alpha - kLog2AlphaMin + 1e-3F;
    inv_uxx = 1.0F / u.uxx;
    // Of the box: reach sigma, with room for rounding.
    const float reach = sqrtf(level) * (1.0F / kConicScale), root_a = sqrtf(p.a);
    const float half_x = reach * root_a;
    half_y = reach * sqrtf(p.c);
    rightmost_dy = reach * p.b / root_a;
    if (!(x + half_x + kMargin >= 0.5F && x - half_x - kMargin <= w.width - 0.5F)) return false;
    const float low = y - half_y - kMargin - 0.5F, high = y + half_y + kMargin - 0.5F;
    if (!(high >= 0.0F && low <= w.height - 1)) return false;
    // Rows of the first and the last pixel centre within.
    row_low = static_cast<int>(fmaxf(ceilf(low), 0.0F)) / kTileSize;
    row_high = static_cast<int>(fminf(floorf(high), w.height - 1.0F)) / kTileSize + 1;
    return row_low < row_high;
  }

  /// Columns of patches [first, last] with a pixel centre in the ellipse, in the row of patches that begins at pixel
  /// row y0; empty when last < first.
  __device__ void columns(int y0, const WorkspaceView& w, int& first, int& last) const {
    first = 1;
    last = 0;
    const float top = y0 + 0.5F - y, bottom = fminf(y0 + kPatchHeight, w.height) - 0.5F - y;
    const float low = fmaxf(top - kMargin, -half_y), high = fminf(bottom + kMargin, half_y);
    if (low > high) return;
    // Within a band of dy the right end lies at the dy of the rightmost point, clamped to the band.
    const float dy_right = fminf(fmaxf(rightmost_dy, low), high), dy_left = fminf(fmaxf(-rightmost_dy, low), high);
    const float v_right = conic.uyy * dy_right, v_left = conic.uyy * dy_left;
    const float right = x + kMargin + inv_uxx * (sqrtf(fmaxf(level - v_right * v_right, 0.0F)) - conic.uxy * dy_right);
    const float left = x - kMargin - inv_uxx * (sqrtf(fmaxf(level - v_left * v_left, 0.0F)) + conic.uxy * dy_left);
    const float first_pixel = fmaxf(ceilf(left - 0.5F), 0.0F);
    const float last_pixel = fminf(floorf(right - 0.5F), w.width - 1.0F);
    if (!(first_pixel <= last_pixel)) return;
    first = static_cast<int>(first_pixel) / kPatchWidth;
    last = static_cast<int>(last_pixel) / kPatchWidth;
  }

  /// Calls `visit(tile, patches)` for the tiles of this view that it meets, with a bit for each patch, and returns how
  /// many.
  template <class Visit>
  __device__ std::uint32_t for_each_tile(const WorkspaceView& w, Visit visit) const {
    std::uint32_t count = 0;
    for (int row = row_low; row < row_high; ++row) {
      int first[kPatchRows], last[kPatchRows];
      int column = w.tiles_x, end = 0;
#pragma unroll
      for (int k = 0; k < kPatchRows; ++k) {
        columns(row * kTileSize + k * kPatchHeight, w, first[k], last[k]);
        if (last[k] < first[k]) continue;
        column = min(column, first[k] / kPatchColumns);
        end = max(end, last[k] / kPatchColumns + 1);
      }
      for (; column < end; ++column) {
        std::uint32_t patches = 0;
#pragma unroll
        for (int k = 0; k < kPatchRows; ++k) {
#pragma unroll
          for (int c = 0; c < kPatchColumns; ++c) {
            const int at = kPatchColumns * column + c;
            if (first[k] <= at && at <= last[k]) patches |= 1U << (kPatchColumns * k + c);
          }
        }
        const int tile = row * w.tiles_x + column;
        if (patches == 0) continue;
        visit(tile, patches);
        ++count;
      }
    }
    return count;
  }
};

}  // namespace splatbus::raster::cuda

#pragma once

#include "raster/cuda/workspace.h"

namespace splatbus::raster::cuda {

constexpr float kAlphaMin = 1.0F / 255.0F;
constexpr float kAlphaMax = 0.999F;
constexpr float kTransmittanceMin = 1e-4F;

/// The ellipse in which a Gaussian's alpha reaches 1/255, and the tiles that it meets (exact, up to a margin).
struct Footprint {
  float x, y;  // centre, pixels
  float conic_a, conic_b, conic_c;
  float level;           // the ellipse is q^T conic q <= level
  float half_x, half_y;  // of its bounding box
  float slope_x;         // dy of the rightmost point, as a part of half_x
  float margin;
  int row_low, row_high;  // tile rows, half open

  /// False when it misses the image.
  __device__ bool set(float center_x, float center_y, float a, float b, float c, float det, float alpha_peak,
                      float margin_px, const WorkspaceView& w) {
    x = center_x;
    y = center_y;
    const float inv_det = 1.0F / det;
    conic_a = c * inv_det;
    conic_b = -b * inv_det;
    conic_c = a * inv_det;
    level = 2.0F * __logf(alpha_peak * 255.0F);
    half_x = sqrtf(level * a);
    half_y = sqrtf(level * c);
    slope_x = b / a;
    margin = margin_px;
    const float low = (y - half_y - margin) * (1.0F / kTileSize), high = (y + half_y + margin) * (1.0F / kTileSize);
    if (!(x + half_x + margin > 0.0F && x - half_x - margin < w.width && high > 0.0F && low < w.tiles_y)) return false;
    row_low = max(0, static_cast<int>(floorf(low)));
    row_high = min(w.tiles_y, static_cast<int>(floorf(high)) + 1);
    return row_low < row_high;
  }

  /// x-range of the ellipse between the lines y_low and y_high (pixels); empty when right < left.
  __device__ void span(float y_low, float y_high, float& left, float& right) const {
    const float low = fmaxf(y_low - margin - y, -half_y), high = fminf(y_high + margin - y, half_y);
    if (low > high) {
      left = 1.0F;
      right = 0.0F;
      return;
    }
    const float extreme = slope_x * half_x;
    const float dy_right = fminf(fmaxf(extreme, low), high), dy_left = fminf(fmaxf(-extreme, low), high);
    const float inv = 1.0F / conic_a, det = conic_a * conic_c - conic_b * conic_b;
    right = x + margin + inv * (-conic_b * dy_right + sqrtf(fmaxf(conic_a * level - det * dy_right * dy_right, 0.0F)));
    left = x - margin + inv * (-conic_b * dy_left - sqrtf(fmaxf(conic_a * level - det * dy_left * dy_left, 0.0F)));
  }

  /// Calls `visit(tile)` for the tiles of this view that it meets, and returns how many. `limits`, when not null: tiles
  /// whose limit lies before `depth` are left out.
  template <class Visit>
  __device__ std::uint32_t for_each_tile(const WorkspaceView& w, const float* limits, float depth, Visit visit) const {
    std::uint32_t count = 0;
    for (int row = row_low; row < row_high; ++row) {
      float left = 0.0F, right = 0.0F;
      span(static_cast<float>(row * kTileSize), static_cast<float>((row + 1) * kTileSize), left, right);
      if (right < left) continue;
      const int low = max(0, static_cast<int>(floorf(left * (1.0F / kTileSize))));
      const int high = min(w.tiles_x, static_cast<int>(floorf(right * (1.0F / kTileSize))) + 1);
      for (int column = low; column < high; ++column) {
        const int tile = row * w.tiles_x + column;
        if (limits != nullptr && depth > limits[tile]) continue;
        visit(tile);
        ++count;
      }
    }
    return count;
  }
};

}  // namespace splatbus::raster::cuda

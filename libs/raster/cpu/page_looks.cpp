// What the last forward pass shows of each page.

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "raster/cpu/cpu_rasterizer.h"

namespace splatbus::raster::cpu {

namespace {

const float kLog2AlphaMin = std::log2(kAlphaMin);

/// Which of a tile's pixels a look blends again, in block order: all of them in kTilePixels looks.
std::uint32_t pixel_of_look(std::uint32_t tile, std::uint32_t look) {
  const std::uint32_t first = (tile * 0x9E3779B9U) >> 16U;
  constexpr std::uint32_t kStride = 37;  // odd: each has its turn
  return (first + kStride * look) % kTilePixels;
}

}  // namespace

void CpuRasterizer::look_at_pages(const Image& error, std::vector<PageLook>& looks) {
  if (!frame_.keep) throw std::invalid_argument("rasterizer: look_at_pages() without forward()");
  const Camera& camera = frame_.camera;
  if (error.channels != 1 || error.width != camera.width || error.height != camera.height) {
    throw std::invalid_argument("rasterizer: the errors' size is not that of the render");
  }
  looks.clear();
  page_sums_.assign((frame_.gaussians.count >> frame_.gaussians.page_shift) + 1, {});
  for (std::uint32_t tile = 0; tile < frame_.tile_count(); ++tile) look_at_tile(tile, error);
  ++looks_;
  for (std::uint32_t page = 0; page < page_sums_.size(); ++page) {
    const PageLook& sums = page_sums_[page];
    if (sums.weight_px > 0) looks.push_back({page, sums.weight_px, sums.error / static_cast<double>(sums.weight_px)});
  }
}

/// Blends one of its pixels for all of them.
void CpuRasterizer::look_at_tile(std::uint32_t tile, const Image& error) {
  const std::uint32_t x0 = tile % frame_.tiles_x * kTileSide, y0 = tile / frame_.tiles_x * kTileSide;
  const std::uint32_t x1 = std::min(error.width, x0 + kTileSide), y1 = std::min(error.height, y0 + kTileSide);
  const std::uint32_t index = pixel_of_look(tile, looks_);
  const std::uint32_t x = x0 + block_order_x(index), y = y0 + block_order_y(index);
  if (x >= x1 || y >= y1 || !(error.data[std::size_t{y} * error.width + x] >= 0)) return;
  double sum = 0;
  std::uint32_t counted = 0;
  for (std::uint32_t row = y0; row < y1; ++row) {
    for (std::uint32_t column = x0; column < x1; ++column) {
      const float value = error.data[std::size_t{row} * error.width + column];
      if (!(value >= 0)) continue;
      sum += value;
      ++counted;
    }
  }
  weigh_pixel(tile, index, sum / counted);
}

void CpuRasterizer::weigh_pixel(std::uint32_t tile, std::uint32_t index, double error) {
  const float x = static_cast<float>(tile % frame_.tiles_x * kTileSide + block_order_x(index)) + 0.5F;
  const float y = static_cast<float>(tile / frame_.tiles_x * kTileSide + block_order_y(index)) + 0.5F;
  const std::uint32_t block = index / kBlockPixels;
  const TileEntry* const entries = frame_.entries.data() + frame_.tile_begin[tile];
  const std::uint32_t end = frame_.block_entries[std::size_t{tile} * kTileBlocks + block];
  const TileEntry bit = TileEntry{1} << (kBlockShift + block);
  float transmittance = 1;
  for (std::uint32_t k = 0; k < end && transmittance >= kHiddenTransmittance; ++k) {
    if ((entries[k] & bit) == 0) continue;
    const std::uint32_t gaussian = entries[k] & kGaussianMask;
    const Splat& splat = frame_.splats[gaussian];
    const float dx = x - splat.x, dy = y - splat.y;
    const float u = splat.uxx * dx + splat.uxy * dy, v = splat.uyy * dy;
    const float log2_alpha = splat.log2_alpha - u * u - v * v;
    if (log2_alpha < kLog2AlphaMin) continue;
    const float weight = std::min(std::exp2(log2_alpha), kAlphaMax) * transmittance;
    transmittance -= weight;
    PageLook& sums = page_sums_[gaussian >> frame_.gaussians.page_shift];
    sums.weight_px += static_cast<float>(kTilePixels) * weight;
    sums.error += kTilePixels * static_cast<double>(weight) * error;
  }
}

}  // namespace splatbus::raster::cpu

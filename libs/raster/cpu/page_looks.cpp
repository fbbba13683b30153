// What the last forward pass shows of each page.

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "raster/cpu/cpu_rasterizer.h"

namespace splatbus::raster::cpu {

namespace {

constexpr std::uint64_t kWeighEvery = 16;  // looks: one costs a tenth of blending

/// A pixel of the tile's, another one with each look.
std::uint32_t some_pixel(std::uint32_t tile, std::uint64_t look) {
  const std::uint64_t mixed = (tile + (look << 32U)) * 0x9E3779B97F4A7C15U;
  return static_cast<std::uint32_t>(mixed >> 40U) % kTilePixels;
}

}  // namespace

void CpuRasterizer::look_at_pages(const Image& error, std::vector<PageLook>& looks) {
  if (!frame_.keep) throw std::invalid_argument("rasterizer: look_at_pages() without forward()");
  const Camera& camera = frame_.camera;
  if (error.channels != 1 || error.width != camera.width || error.height != camera.height) {
    throw std::invalid_argument("rasterizer: the errors' size is not that of the render");
  }
  looks.clear();
  const bool weighs = looks_++ % kWeighEvery == 0;
  page_sums_.assign((frame_.gaussians.count >> frame_.gaussians.page_shift) + 1, {});
  for (std::uint32_t tile = 0; tile < frame_.tile_count(); ++tile) {
    const std::uint32_t x0 = tile % frame_.tiles_x * kTileSide, y0 = tile / frame_.tiles_x * kTileSide;
    const std::uint32_t x1 = std::min(camera.width, x0 + kTileSide), y1 = std::min(camera.height, y0 + kTileSide);
    double sum = 0;
    std::uint32_t pixels = 0;
    for (std::uint32_t y = y0; y < y1; ++y) {
      for (std::uint32_t x = x0; x < x1; ++x) {
        const float value = error.data[std::size_t{y} * camera.width + x];
        if (!(value >= 0)) continue;
        sum += value;
        ++pixels;
      }
    }
    if (pixels == 0) continue;
    const std::uint32_t* const ends = frame_.block_entries.data() + std::size_t{tile} * kTileBlocks;
    const TileEntry* const entries = frame_.entries.data() + frame_.tile_begin[tile];
    const std::uint32_t end = *std::max_element(ends, ends + kTileBlocks);
    for (std::uint32_t k = 0; k < end; ++k) {
      PageLook& of = page_sums_[(entries[k] & kGaussianMask) >> frame_.gaussians.page_shift];
      of.error += sum / pixels;
      of.pairs += 1;
    }
    if (weighs) weigh_pixel(tile);
  }
  for (std::uint32_t page = 0; page < page_sums_.size(); ++page) {
    const PageLook& sums = page_sums_[page];
    if (sums.pairs == 0) continue;
    looks.push_back({.page = page,
                     .pairs = sums.pairs,
                     .error = sums.error / sums.pairs,
                     .weight_px = weighs ? std::max(sums.weight_px, 0.0F) : -1});
  }
}

/// Blends one pixel for all of the tile's, and adds up whose weights it has.
void CpuRasterizer::weigh_pixel(std::uint32_t tile) {
  const std::uint32_t index = some_pixel(tile, looks_), block = index / kBlockPixels;
  const std::uint32_t x0 = tile % frame_.tiles_x * kTileSide, y0 = tile / frame_.tiles_x * kTileSide;
  const std::uint32_t width = std::min(kTileSide, frame_.camera.width - x0);
  const std::uint32_t height = std::min(kTileSide, frame_.camera.height - y0);
  const std::uint32_t in_x = block_order_x(index), in_y = block_order_y(index);
  if (in_x >= width || in_y >= height) return;
  const float x = static_cast<float>(x0 + in_x) + 0.5F, y = static_cast<float>(y0 + in_y) + 0.5F;
  const auto pixels = static_cast<float>(width * height);
  const TileEntry* const entries = frame_.entries.data() + frame_.tile_begin[tile];
  const std::uint32_t end = frame_.block_entries[std::size_t{tile} * kTileBlocks + block];
  const TileEntry bit = TileEntry{1} << (kBlockShift + block);
  float transmittance = 1;
  for (std::uint32_t k = 0; k < end && transmittance >= kTransmittanceMin; ++k) {
    if ((entries[k] & bit) == 0) continue;
    const std::uint32_t gaussian = entries[k] & kGaussianMask;
    const Splat& splat = frame_.splats[gaussian];
    const float dx = x - splat.x, dy = y - splat.y;
    const float u = splat.uxx * dx + splat.uxy * dy, v = splat.uyy * dy;
    const float alpha = std::min(std::exp2(splat.log2_alpha - u * u - v * v), kAlphaMax);
    if (alpha < kAlphaMin) continue;
    float& sum = page_sums_[gaussian >> frame_.gaussians.page_shift].weight_px;
    sum = std::max(sum, 0.0F) + pixels * alpha * transmittance;
    transmittance -= alpha * transmittance;
  }
}

}  // namespace splatbus::raster::cpu

#include "trainer/unmodelled.h"

#include <algorithm>

#include "raster/unmodelled.h"

namespace splatbus::trainer {

std::size_t mask_unmodelled(const raster::Image& alpha, const TrainingView& view, float opacity,
                            std::span<const float> near_opacity, std::vector<std::uint8_t>& mask) {
  const std::uint32_t width = view.camera.width, height = view.camera.height;
  const std::size_t pixels = std::size_t{width} * height;
  mask.assign(pixels, 0);
  if (!view.mask.empty()) std::copy_n(view.mask.data(), pixels, mask.begin());
  constexpr std::uint32_t kSide = raster::kUnmodelledSide;
  const std::uint32_t columns = (width + kSide - 1) / kSide;
  // There are samples of the square that show a surface, and what is near does not hide the far field there.
  const auto lacks_near = [&](std::uint32_t x0, std::uint32_t y0) {
    if (near_opacity.empty()) return false;
    const std::size_t square = std::size_t{y0 / kSide} * columns + x0 / kSide;
    float sum = 0, samples = 0;
    for (int k = 0; k < raster::kUnmodelledSamples; ++k) {
      const auto offset = static_cast<std::uint32_t>(raster::unmodelled_sample(k));
      if (x0 + offset >= width || y0 + offset >= height) continue;
      if (!raster::shows_surface(view.depth[std::size_t{y0 + offset} * width + x0 + offset])) continue;
      sum += near_opacity[square * raster::kUnmodelledSamples + static_cast<std::size_t>(k)];
      samples += 1;
    }
    return samples > 0 && sum < opacity * samples;
  };
  std::size_t masked = 0;
  for (std::uint32_t y0 = 0; y0 < height; y0 += kSide) {
    for (std::uint32_t x0 = 0; x0 < width; x0 += kSide) {
      const auto for_square = [&](auto&& visit) {
        for (std::uint32_t y = y0; y < std::min(height, y0 + kSide); ++y) {
          for (std::uint32_t x = x0; x < std::min(width, x0 + kSide); ++x) {
            const std::size_t i = std::size_t{y} * width + x;
            if (raster::shows_surface(view.depth[i])) visit(i);
          }
        }
      };
      double sum = 0;
      std::size_t surface = 0;
      for_square([&](std::size_t i) {
        sum += alpha.data[i];
        ++surface;
      });
      if (surface == 0) continue;
      const bool empty = sum < static_cast<double>(opacity) * static_cast<double>(surface);
      const bool shows_far_field = lacks_near(x0, y0);
      if (!empty && !shows_far_field) continue;
      for_square([&](std::size_t i) {
        if ((alpha.data[i] >= opacity && !shows_far_field) || mask[i] != 0) return;
        mask[i] = 255;
        ++masked;
      });
    }
  }
  return masked;
}

}  // namespace splatbus::trainer

#include "trainer/unmodelled.h"

#include <algorithm>

#include "raster/unmodelled.h"

namespace splatbus::trainer {

std::size_t mask_unmodelled(const raster::Image& alpha, const TrainingView& view, float opacity,
                            std::vector<std::uint8_t>& mask) {
  const std::uint32_t width = view.camera.width, height = view.camera.height;
  const std::size_t pixels = std::size_t{width} * height;
  mask.assign(pixels, 0);
  if (!view.mask.empty()) std::copy_n(view.mask.data(), pixels, mask.begin());
  constexpr std::uint32_t kSide = raster::kUnmodelledSide;
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
      if (surface == 0 || sum >= static_cast<double>(opacity) * static_cast<double>(surface)) continue;
      for_square([&](std::size_t i) {
        if (alpha.data[i] >= opacity || mask[i] != 0) return;
        mask[i] = 255;
        ++masked;
      });
    }
  }
  return masked;
}

}  // namespace splatbus::trainer

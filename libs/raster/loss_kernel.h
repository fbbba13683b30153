#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

namespace splatbus::raster {

constexpr int kSsimRadius = 5;

/// The passes of the loss over one colour channel, each on rows [begin, end). A pass needs the one before it to be
/// complete for the rows within kSsimRadius. Rendered, target and gradient are whole pictures; the planes between the
/// passes have their first row at `first_row`, so that a band of rows and its surroundings fit in the cache.
struct LossBand {
  std::uint32_t width = 0, height = 0, channel = 0, first_row = 0;
  bool encode_srgb = true;
  float ssim_scale = 0, l1_scale = 0;  ///< gradient of the loss by a pixel's SSIM (negated) and by |x - y|
  const float* rendered = nullptr;
  const std::uint8_t* target_rgba = nullptr;
  float* shown = nullptr;                 ///< x: the rendered channel in display space
  float* target = nullptr;                ///< y
  std::array<float*, 5> row_blurred{};    ///< x, y, xx, yy, xy blurred along rows
  std::array<float*, 3> row_gradients{};  ///< dSSIM/d(mean x, mean xx, mean xy) blurred along rows
  float* gradient = nullptr;              ///< out
};

struct LossSums {
  double l1 = 0, ssim = 0;
};

void loss_blur_rows(const LossBand& band, std::uint32_t begin, std::uint32_t end);
LossSums loss_ssim_rows(const LossBand& band, std::uint32_t begin, std::uint32_t end);
void loss_gradient_rows(const LossBand& band, std::uint32_t begin, std::uint32_t end);

}  // namespace splatbus::raster

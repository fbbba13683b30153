#pragma once

#include <cstddef>
#include <cstdint>

namespace splatbus::raster {

/// One colour channel of a picture and of its target, as the loss looks at them.
struct LossChannel {
  std::uint32_t width = 0, height = 0, channel = 0;
  bool encode_srgb = true;
  float ssim_scale = 0, l1_scale = 0;  ///< gradient of the loss by a pixel's SSIM (negated) and by |x - y|
  const float* rendered = nullptr;     ///< [height][width]
  const std::uint8_t* target_rgba = nullptr;
  const std::uint8_t* mask = nullptr;  ///< as in LossOptions
  float* gradient = nullptr;           ///< out, [height][width]
};

struct LossSums {
  double l1 = 0, ssim = 0;
};

/// Scratch memory of loss_rows(), floats at a multiple of 64 bytes.
[[nodiscard]] std::size_t loss_scratch_floats(std::uint32_t width);

/// Gradient of rows [begin, end), and the sums over their pixels. Rows around them are looked at too: what leads from a
/// picture to a gradient is kept for the last few rows only, and never leaves the cache.
[[nodiscard]] LossSums loss_rows(const LossChannel& channel, std::uint32_t begin, std::uint32_t end, float* scratch);

}  // namespace splatbus::raster

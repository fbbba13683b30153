#pragma once

#include <cstdint>

#include "raster/rasterizer.h"

namespace splatbus::raster {

struct LossOptions {
  float ssim_weight =
      0.2F;  ///< lambda in (1 - lambda) L1 + lambda (1 - SSIM), SSIM 11x11 sigma 1.5, zero padding as 3DGS
  bool encode_srgb = true;  ///< the render is linear: clamp to [0, 1] and apply the sRGB curve before comparing
  const std::uint8_t* mask = nullptr;  ///< [height][width]; null: 0 everywhere
  int threads = 0;                     ///< at most, 0: all cores
};

/// Loss of a rendered 3-plane image against an interleaved u8 RGBA target in display space (alpha is not read), and its
/// gradient with respect to the rendered planes (sized here). The clamp to [0, 1] passes gradients that point back
/// inside. Where `options.mask` is not 0 the target counts as what is rendered, whatever it shows: these pixels have no
/// gradient, and nothing of them is in the windows of others.
[[nodiscard]] float image_loss(const Image& rendered, const std::uint8_t* target_rgba, const LossOptions& options,
                               Image& gradient);

/// |rendered - target| of each pixel in display space, the mean of its colours, in one plane (sized here); -1 where the
/// mask is not 0. The sRGB curve is a table of 4,096 values.
void l1_error(const Image& rendered, const std::uint8_t* target_rgba, bool encode_srgb, const std::uint8_t* mask,
              Image& error);

}  // namespace splatbus::raster

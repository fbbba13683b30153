#pragma once

namespace splatbus::device {

/// srgb_from_linear() of gaussians/light.h (IEC 61966-2-1), on the device: clamps to [0, 1].
__device__ inline float srgb_from_linear(float linear) {
  const float x = fminf(fmaxf(linear, 0.0F), 1.0F);
  return x <= 0.0031308F ? 12.92F * x : 1.055F * powf(x, 1 / 2.4F) - 0.055F;
}

}  // namespace splatbus::device

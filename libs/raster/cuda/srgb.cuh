#pragma once

namespace splatbus::raster::cuda {

__device__ inline float srgb_from_linear(float v) {
  v = fminf(fmaxf(v, 0.0F), 1.0F);
  return v <= 0.0031308F ? 12.92F * v : 1.055F * __powf(v, 1.0F / 2.4F) - 0.055F;
}

/// As the eye and a picture's bytes have it.
__device__ inline float display(float value, bool encode) {
  return encode ? srgb_from_linear(value) : value;
}

}  // namespace splatbus::raster::cuda

#pragma once

#include <cstddef>
#include <cstdint>

namespace splatbus::raster {

/// One Adam step over consecutive Gaussians that lie in one page, at most kAdamPiece of them. Pointers are to the first
/// of them; channels are a stride apart.
struct AdamStep {
  int channels = 0;
  std::size_t stride = 0, gradient_stride = 0, moment_stride = 0;
  float* parameters = nullptr;
  const float* gradient = nullptr;
  const std::uint8_t* touched = nullptr;
  const std::uint32_t* flags = nullptr;
  const float* learning_rate = nullptr;
  float* first = nullptr;
  float* second = nullptr;
  std::uint32_t* steps = nullptr;
  float beta1 = 0, beta2 = 0, epsilon = 0;
  float lr_half_life_steps = 0, lr_min_factor = 0;  ///< as in Adam
  int unit_begin = 0, unit_end = 0;                 ///< channels that stay within [0, 1]
};
constexpr std::size_t kAdamPiece = 256;
void adam_range(const AdamStep& step, std::size_t count);

}  // namespace splatbus::raster

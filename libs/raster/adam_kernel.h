#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

namespace splatbus::raster {

/// A view's depth at a point of a page's frame, metres: x, y, z times the point's, and offset; and its focal length,
/// pixels.
struct ViewDistance {
  float x = 0, y = 0, z = 0, offset = 0, focal_px = 0;
};
inline constexpr std::size_t kMaxDistances = 8;  ///< of views of a step, the first

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
  float* near_steps = nullptr;  ///< of LearningAge
  float* detail = nullptr;      ///< of LearningAge
  float beta1 = 0, beta2 = 0, epsilon = 0;
  float lr_half_life_steps = 0, lr_min_factor = 0;  ///< as in Adam
  int unit_begin = 0, unit_end = 0;                 ///< channels that stay within [0, 1]
  std::array<ViewDistance, kMaxDistances> distances{};
  std::size_t distance_count = 0;  ///< 0: every view teaches all there is
  bool loss_has_risen = false;     ///< of a view
};
constexpr std::size_t kAdamPiece = 256;
void adam_range(const AdamStep& step, std::size_t count);

}  // namespace splatbus::raster

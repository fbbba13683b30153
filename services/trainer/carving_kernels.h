#pragma once

#include <cstddef>
#include <cstdint>

#include "trainer/gaussian_kernels.h"

namespace splatbus::trainer {

namespace kernels {

/// Where a picture was taken from, as seen by one frame of reference.
struct CameraOfFrame {
  std::uint32_t frame_id = kWorldFrame;
  math::Similarity camera_from_frame;
  float log_scale = 0;  ///< of the frame
  PageFrustum frustum;  ///< of the frame
};

/// What an engine saw, without its colours.
struct DepthPicture {
  float fx = 0, fy = 0, cx = 0, cy = 0;  ///< pixels
  float near_m = 0, far_m = 0;
  int width = 0, height = 0;
  const float* depth = nullptr;            ///< [height][width] metres along z, 0: nothing is there
  const CameraOfFrame* cameras = nullptr;  ///< ascending by frame; Gaussians of other frames are hidden
  std::uint32_t camera_count = 0;
  std::uint8_t instant = 1;  ///< of the engine, 1 to kInstants: pictures of one have the same
};
inline constexpr std::uint32_t kInstants = 15;
inline constexpr std::uint32_t kMaxCarveVotes = 15;

enum class Verdict : std::uint8_t {
  None,       ///< outside of the picture, hidden, or too fine for its pixels
  Free,       ///< the engine sees what lies behind it, all around
  Supported,  ///< the engine sees a surface there
};

/// How near to a surface a Gaussian stands on it: so many of its largest standard deviations, and a part of its depth.
inline constexpr float kSupportDeviations = 3, kSupportDepthPart = 0.015F;
/// Half of a Gaussian's width in standard deviations. One that is far narrower than a pixel, by its second largest
/// axis, can fall between what an engine samples. (Trained surfaces consist of Gaussians half a pixel wide.)
inline constexpr float kHalfWidthDeviations = 2, kLeastWidth_px = 0.125F;

/// Of a Gaussian with its mean at `at` (camera's frame, metres) and these logarithms of its standard deviations.
[[nodiscard]] SPLATBUS_PORTABLE Verdict judge(const DepthPicture& picture, const math::Vec3& at,
                                              const math::Vec3& log_scale) {
  if (!(at.z > picture.near_m && at.z < picture.far_m)) return Verdict::None;
  const float u = picture.fx * at.x / at.z + picture.cx, v = picture.fy * at.y / at.z + picture.cy;
  if (!(u >= 0 && u < static_cast<float>(picture.width) && v >= 0 && v < static_cast<float>(picture.height))) {
    return Verdict::None;
  }
  const auto depth_at = [&](float x, float y) {
    const int column = static_cast<int>(math::clamped(x, 0, static_cast<float>(picture.width - 1)));
    const int row = static_cast<int>(math::clamped(y, 0, static_cast<float>(picture.height - 1)));
    const float depth = picture.depth[static_cast<std::size_t>(row) * static_cast<std::size_t>(picture.width) +
                                      static_cast<std::size_t>(column)];
    return depth > 0 ? depth : (depth == 0 ? INFINITY : 0);  // what makes no sense hides everything
  };
  // Most stand here, and it is told without their size.
  if (fabsf(depth_at(u, v) - at.z) <= kSupportDepthPart * at.z) return Verdict::Supported;
  const float a = log_scale.x, b = log_scale.y, c = log_scale.z;
  const float largest_m = expf(math::larger(a, math::larger(b, c)));
  const float margin = kSupportDeviations * largest_m + kSupportDepthPart * at.z;
  float least = INFINITY;
  for (int k = 0; k < 9; ++k) {
    const int column = k % 3 - 1, row = k / 3 - 1;
    const float depth = depth_at(u + static_cast<float>(column), v + static_cast<float>(row));
    if (fabsf(depth - at.z) <= margin) return Verdict::Supported;
    least = math::smaller(depth, least);
  }
  if (!(at.z + margin < least)) return Verdict::None;
  const float second_m = expf(math::larger(math::smaller(a, b), math::smaller(math::larger(a, b), c)));
  const float px_per_m = math::smaller(picture.fx, picture.fy) / at.z;
  if (!(2 * kHalfWidthDeviations * second_m * px_per_m >= kLeastWidth_px)) return Verdict::None;
  const float reach_px = kHalfWidthDeviations * largest_m * math::larger(picture.fx, picture.fy) / at.z;
  for (int k = 0; k < 9 && reach_px > 1; ++k) {
    const int column = k % 3 - 1, row = k / 3 - 1;
    const float depth = depth_at(u + reach_px * static_cast<float>(column), v + reach_px * static_cast<float>(row));
    if (!(at.z + margin < depth)) return Verdict::None;
  }
  return Verdict::Free;
}

struct CarveLimits {
  std::uint32_t votes = 2;  ///< of different instants, 1 to kMaxCarveVotes
  float min_opacity_logit = 0;
};

/// Takes a picture into standing[index]: its votes for being free in the upper 4 bits, below them the instant of the
/// last verdict. An instant has one vote, and none where it also shows a surface. *carvable grows by those that have
/// just got as many votes as it takes. `bounds`: of each range.
void judge_gaussians(StreamView stream, const PagedGaussians& gaussians, const PageBounds* bounds,
                     const DepthPicture& picture, const CarveLimits& limits, std::uint8_t* standing,
                     std::uint32_t* carvable);

/// dead[index] = 1 for those with so many votes, 0 for others; adds their number to *count.
void mark_free(StreamView stream, const PagedGaussians& gaussians, const std::uint8_t* standing, std::uint32_t votes,
               std::uint8_t* dead, std::uint32_t* count);

}  // namespace kernels

}  // namespace splatbus::trainer

#pragma once

#include <cstdint>

namespace splatbus {

/// The one limit of a picture's size, which everybody on its way checks: who asks for it, who renders it, who carries
/// it and who shows it.
inline constexpr std::uint32_t kMaxPictureSide = 8192;
inline constexpr std::uint64_t kMaxPicturePixels = std::uint64_t{1} << 24;

/// A light's depth map, of 4 bytes a pixel and shown to nobody, may have all of its sides.
[[nodiscard]] constexpr bool is_picture_size(std::uint32_t width, std::uint32_t height, bool depth_map) {
  if (width == 0 || height == 0 || width > kMaxPictureSide || height > kMaxPictureSide) return false;
  return depth_map || std::uint64_t{width} * height <= kMaxPicturePixels;
}

}  // namespace splatbus

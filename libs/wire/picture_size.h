#pragma once

#include <cstdint>

namespace splatbus {

/// The one limit of a picture's sides, which everybody on its way checks. A camera that asks nobody for pixels, such as
/// where a viewer stands, has no other; nor have the pictures that an engine sends of its own accord.
inline constexpr std::uint32_t kMaxPictureSide = 8192;
/// Of one that somebody else has to render, carry and keep for a viewer.
inline constexpr std::uint64_t kMaxProbePixels = std::uint64_t{1} << 24;

[[nodiscard]] constexpr bool is_picture_size(std::uint32_t width, std::uint32_t height) {
  return width != 0 && height != 0 && width <= kMaxPictureSide && height <= kMaxPictureSide;
}

[[nodiscard]] constexpr bool is_probe_size(std::uint32_t width, std::uint32_t height) {
  return is_picture_size(width, height) && std::uint64_t{width} * height <= kMaxProbePixels;
}

}  // namespace splatbus

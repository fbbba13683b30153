#pragma once

#include <cstddef>
#include <cstdint>

#include "gaussians/layout.h"
#include "gaussians/pages.h"

// The channels of a page and where they lie in its block: [rows][kRowWords] words of 4 bytes, of which kPageLanes are
// used, page after page. Whoever reads, writes or copies a page takes this list; a channel is added here and nowhere
// else.
namespace splatbus::model {

enum class ChannelType : std::uint8_t { F32, U64 };

/// The trained parameters come first, so that a GaussiansView's channels are a page's rows.
enum class Channel : std::uint8_t { Parameters, Average, Normal, SurfacePoint, Visibility, GaussianId };
inline constexpr Channel kChannels[] = {Channel::Parameters,   Channel::Average,    Channel::Normal,
                                        Channel::SurfacePoint, Channel::Visibility, Channel::GaussianId};

struct ChannelRows {
  const char* name;
  ChannelType type;
  std::uint32_t first = 0;  ///< row
  std::uint32_t rows = 0;   ///< of 4-byte words; a U64 channel takes two, read as one array [kPageLanes]
};

[[nodiscard]] constexpr ChannelRows rows_of(Channel channel, const ParameterLayout& layout) {
  const auto parameters = static_cast<std::uint32_t>(layout.channels());
  switch (channel) {
    case Channel::Parameters:
      return {"parameters", ChannelType::F32, 0, parameters};
    case Channel::Average:
      return {"average", ChannelType::F32, parameters, parameters};
    case Channel::Normal:
      return {"normal", ChannelType::F32, 2 * parameters, 3};
    case Channel::SurfacePoint:
      return {"surface_point", ChannelType::F32, 2 * parameters + 3, 3};
    case Channel::Visibility:
      return {"visibility", ChannelType::F32, 2 * parameters + 6, 1};
    case Channel::GaussianId:
      return {"gaussian_id", ChannelType::U64, 2 * parameters + 7, 2};
  }
  return {"", ChannelType::F32};
}

/// Rows that hold something.
[[nodiscard]] constexpr std::uint32_t used_rows(const ParameterLayout& layout) {
  const ChannelRows last = rows_of(Channel::GaussianId, layout);
  return last.first + last.rows;
}
/// A multiple of 4 rows' lanes, so that a page of 1,024 lanes is a multiple of 16 KiB and an arena one of 2 MiB.
[[nodiscard]] constexpr std::uint32_t page_words(const ParameterLayout& layout) {
  constexpr std::uint32_t kUnit = 4 * kPageLanes;
  return (used_rows(layout) * kRowWords + kUnit - 1) / kUnit * kUnit;
}
[[nodiscard]] constexpr std::size_t page_bytes(const ParameterLayout& layout) {
  return std::size_t{page_words(layout)} * sizeof(std::uint32_t);
}

/// The most rows that any layout has.
inline constexpr std::uint32_t kMaxPageRows = used_rows({.appearance = Appearance::Radiance, .sh_degree = 3});

/// Pages one behind the other, wherever their arenas lie. Kernels take it as it is.
struct PageMemory {
  std::uint32_t* words = nullptr;
  std::size_t page_words = 0;
  std::uint32_t used_rows = 0;
  std::uint32_t normal = 0, surface_point = 0, visibility = 0, gaussian_id = 0;  ///< first rows

  PageMemory() = default;
  PageMemory(std::byte* pages, const ParameterLayout& layout)
      : words(reinterpret_cast<std::uint32_t*>(pages)),
        page_words(model::page_words(layout)),
        used_rows(model::used_rows(layout)),
        normal(rows_of(Channel::Normal, layout).first),
        surface_point(rows_of(Channel::SurfacePoint, layout).first),
        visibility(rows_of(Channel::Visibility, layout).first),
        gaussian_id(rows_of(Channel::GaussianId, layout).first) {}

  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER std::uint32_t* word(std::uint32_t row, std::uint32_t index) const {
    return words + (index >> kPageShift) * page_words + std::size_t{row} * kRowWords + (index & (kPageLanes - 1));
  }
  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER float* value(std::uint32_t row, std::uint32_t index) const {
    return reinterpret_cast<float*>(word(row, index));
  }
  /// Of a U64 channel that begins at `row`.
  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER std::uint64_t* wide(std::uint32_t row, std::uint32_t index) const {
    std::uint32_t* const channel = words + (index >> kPageShift) * page_words + std::size_t{row} * kRowWords;
    return reinterpret_cast<std::uint64_t*>(channel) + (index & (kPageLanes - 1));
  }
};

}  // namespace splatbus::model

#pragma once

#include <cstdint>
#include <vector>

#include "stream/gpu_record.h"

namespace splatbus::viewer::gl {

/// As a row's fade: it has always been there.
inline constexpr float kNoFade = 0;
/// As the time of a picture: all has faded.
inline constexpr float kSettled_s = 1e9F;

/// Rows of which anything is another than before. One without opacity is free.
struct RowUpdate {
  std::vector<std::uint32_t> rows;
  std::vector<stream::GpuRecord> records;  ///< [rows]
  /// [rows] seconds since when it appears; negative: since when it vanishes.
  std::vector<float> fades;
};

/// Rows of which the color alone is another.
struct ColorUpdate {
  std::vector<std::uint32_t> rows, colors;  ///< colors: rgb9e5
};

/// Colors that depend on where one looks from: 48 half floats a row at most, [coefficient][RGB], in display space.
struct Harmonics {
  std::size_t words = 0;              ///< a row; 0: there are none
  std::vector<std::uint32_t> values;  ///< [rows][words], from row 0 on
};

}  // namespace splatbus::viewer::gl

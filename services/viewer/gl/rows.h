#pragma once

#include <cstddef>
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
  /// Of colours that depend on where one looks from: words a row, [coefficient][RGB] as two half floats each, 48 of
  /// them at most, in display space. 0: there are none, in any row.
  std::size_t harmonic_words = 0;
  std::vector<std::uint32_t> harmonics;  ///< [rows][harmonic_words]
};

/// Rows of which the color alone is another.
struct ColorUpdate {
  std::vector<std::uint32_t> rows, colors;  ///< colors: rgb9e5
};

}  // namespace splatbus::viewer::gl

#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "stream/planes/plane_model.h"
#include "stream/planes/shifts.h"

// Residuals as the words of a blob, and back. The vectorised parts pick the best instruction set at run time; what they
// write and read is the same on all.
namespace splatbus::stream::planes {

/// Arrays of lanes are readable and writable up to here.
[[nodiscard]] constexpr std::size_t padded(std::size_t lanes) {
  return (lanes + kStates - 1) / kStates * kStates;
}

/// Of a lane of that shift.
[[nodiscard]] constexpr Spread spread_at(const PlaneModel& model, int shift) {
  return spread_of(model.spread - model.slope * shift);
}

/// What the encoder takes a symbol in with: where its frequency begins | its frequency << 16. Escapes are marked.
using CodedSymbol = std::uint32_t;
inline constexpr CodedSymbol kEscapes = 1U << 15;

/// One plane's symbols. `shift`, at most kMaxShift, and `residual` [count]; `coded` [padded(count)]; `escaped` [count]
/// gets the lanes whose bits travel plainly, ascending. Returns how many those are.
std::size_t put_symbols(const PlaneModel& model, const std::uint8_t* shift, const std::int32_t* residual,
                        std::size_t count, CodedSymbol* coded, std::uint16_t* escaped);

/// The words of all planes, [planes][padded(count)] of symbols, the last first: a decoder begins at the back.
[[nodiscard]] std::vector<std::uint16_t> words_of(const std::vector<CodedSymbol>& coded, std::size_t count);

/// Where a decoder is.
struct WordReader {
  std::array<std::uint32_t, kStates> states{};
  const std::uint16_t* word = nullptr;
};

/// Words that are read ahead of a plane's end, at most, besides one a lane.
inline constexpr std::size_t kWordsAhead = kStates;

/// One plane's residuals above their low bits, into `out` [count]. `escaped` [count] gets the lanes whose bits are
/// plain ones, ascending, their residuals undefined. Returns how many those are. Reads a word a lane at most, and
/// kWordsAhead.
std::size_t read_symbols(WordReader& reader, const PlaneModel& model, const std::uint8_t* shift, std::size_t count,
                         std::int32_t* out, std::uint16_t* escaped);

}  // namespace splatbus::stream::planes

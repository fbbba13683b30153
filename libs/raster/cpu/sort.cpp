#include "raster/cpu/sort.h"

#include <algorithm>
#include <bit>
#include <utility>

namespace splatbus::raster::cpu {
namespace {
constexpr std::size_t kPiece = 16384;
constexpr unsigned kMaxDigitBits = 12;
}  // namespace

void DepthSorter::sort(Scratch<DepthKey>& keys, Scratch<DepthKey>& spare, std::size_t count, Workers& workers) {
  if (count < 2) return;
  std::uint32_t low = keys[0].depth_bits, high = low;
  for (std::size_t i = 1; i < count; ++i) {
    low = std::min(low, keys[i].depth_bits);
    high = std::max(high, keys[i].depth_bits);
  }
  // Two passes tell depths apart to a few units in the last place, which is what their own rounding leaves.
  const auto all_bits = static_cast<unsigned>(std::bit_width(high - low));
  if (all_bits == 0) return;
  const unsigned bits = std::min(all_bits, 2 * kMaxDigitBits), dropped = all_bits - bits;
  const unsigned passes = (bits + kMaxDigitBits - 1) / kMaxDigitBits, digit_bits = (bits + passes - 1) / passes;
  const std::uint32_t digits = 1U << digit_bits;
  const std::size_t pieces = (count + kPiece - 1) / kPiece;

  for (unsigned pass = 0; pass < passes; ++pass) {
    const unsigned shift = dropped + pass * digit_bits;
    const DepthKey* from = keys.data();
    DepthKey* to = spare.data();
    const auto digit = [=](const DepthKey& key) { return (key.depth_bits - low) >> shift & (digits - 1); };
    histograms_.assign(pieces * digits, 0);
    workers.for_pieces(count, kPiece, [&](std::size_t begin, std::size_t end) {
      std::uint32_t* histogram = histograms_.data() + begin / kPiece * digits;
      for (std::size_t i = begin; i < end; ++i) ++histogram[digit(from[i])];
    });
    std::uint32_t next = 0;
    for (std::uint32_t d = 0; d < digits; ++d) {
      for (std::size_t piece = 0; piece < pieces; ++piece) next += std::exchange(histograms_[piece * digits + d], next);
    }
    workers.for_pieces(count, kPiece, [&](std::size_t begin, std::size_t end) {
      std::uint32_t* position = histograms_.data() + begin / kPiece * digits;
      for (std::size_t i = begin; i < end; ++i) to[position[digit(from[i])]++] = from[i];
    });
    std::swap(keys, spare);
  }
}

}  // namespace splatbus::raster::cpu

#include "raster/cpu/sort.h"

#include <algorithm>
#include <bit>
#include <utility>

namespace splatbus::raster::cpu {
namespace {
constexpr std::size_t kSortPiece = 16384;
constexpr unsigned kMaxDigitBits = 12;
}  // namespace

void DepthSorter::sort(Scratch<DepthKey>& keys, Scratch<DepthKey>& spare, std::size_t count, Workers& workers) {
  if (count < 2) return;
  const std::size_t pieces = (count + kSortPiece - 1) / kSortPiece;
  bounds_.resize(pieces);
  workers.for_pieces(count, kSortPiece, [&](std::size_t begin, std::size_t end) {
    std::uint32_t low = keys[begin].depth_bits, high = low;
    for (std::size_t i = begin + 1; i < end; ++i) {
      low = std::min(low, keys[i].depth_bits);
      high = std::max(high, keys[i].depth_bits);
    }
    bounds_[begin / kSortPiece] = {low, high};
  });
  auto [low, high] = bounds_.front();
  for (const Bounds& bounds : bounds_) {
    low = std::min(low, bounds.low);
    high = std::max(high, bounds.high);
  }
  // Two passes tell depths apart to a few units in the last place, which is what their own rounding leaves.
  const auto all_bits = static_cast<unsigned>(std::bit_width(high - low));
  if (all_bits == 0) return;
  const unsigned bits = std::min(all_bits, 2 * kMaxDigitBits), dropped = all_bits - bits;
  const unsigned passes = (bits + kMaxDigitBits - 1) / kMaxDigitBits, digit_bits = (bits + passes - 1) / passes;
  const std::uint32_t digits = 1U << digit_bits;
  begins_.resize(digits + 1);

  for (unsigned pass = 0; pass < passes; ++pass) {
    const unsigned shift = dropped + pass * digit_bits;
    const DepthKey* from = keys.data();
    DepthKey* to = spare.data();
    const auto digit = [shift, digits, lowest = low](const DepthKey& key) {
      return (key.depth_bits - lowest) >> shift & (digits - 1);
    };
    histograms_.resize(pieces * digits);
    workers.for_pieces(count, kSortPiece, [&](std::size_t begin, std::size_t end) {
      std::uint32_t* histogram = histograms_.data() + begin / kSortPiece * digits;
      std::fill_n(histogram, digits, 0);
      for (std::size_t i = begin; i < end; ++i) ++histogram[digit(from[i])];
    });
    scan_.scan(
        pieces, digits, [&](std::size_t piece) { return histograms_.data() + piece * digits; }, begins_.data());
    workers.for_pieces(count, kSortPiece, [&](std::size_t begin, std::size_t end) {
      std::uint32_t* position = histograms_.data() + begin / kSortPiece * digits;
      for (std::size_t i = begin; i < end; ++i) to[position[digit(from[i])]++] = from[i];
    });
    std::swap(keys, spare);
  }
}

}  // namespace splatbus::raster::cpu

#include "stream/page_planes.h"

#include <bit>
#include <cmath>

namespace splatbus::stream::planes {

namespace {

constexpr std::uint64_t kOne = std::uint64_t{1} << 32;

// Of a standard deviation s = 0.1 * 2^(k / 4): exp(-1 / (sqrt(2) s)) and exp(-1 / (2 s^2)), in 2^-32.
constexpr std::array<std::uint32_t, kSpreads> kLaplaceFall = {
    3647826,    11236458,   28939262,   64117488,   125169061,  219682085,  352552385,  524769008,
    733210082,  971353370,  1230528733, 1501288023, 1774574125, 2042530528, 2298930330, 2539287885,
    2760749505, 2961857832, 3142265200, 3302447338, 3443447232, 3566662659, 3673680208, 3766152322};
constexpr std::array<std::uint32_t, kSpreads> kGaussFall = {
    0,          0,          0,          90,         16006,      622734,     8291237,    51716756,
    188707693,  471297971,  900274053,  1422747122, 1966379316, 2471973373, 2906120241, 3258380701,
    3532943729, 3740940864, 3895366193, 4008393527, 4090289770, 4149207046, 4191379343, 4221458109};

std::uint64_t times(std::uint64_t a, std::uint64_t b) {
  return a * b >> 32;  // both at most 1
}

/// Weights of |residual| = 0, 1, ... in 2^-32.
std::array<std::uint64_t, kSymbols / 2> weights(Shape shape, std::size_t spread) {
  std::array<std::uint64_t, kSymbols / 2> out{};
  if (shape == Shape::Laplace) {
    const std::uint64_t half = kLaplaceFall[spread], whole = times(half, half);
    out[0] = kOne - half;
    std::uint64_t weight = times(half, kOne - whole) / 2;
    for (std::size_t k = 1; k < out.size(); ++k, weight = times(weight, whole)) out[k] = weight;
  } else {
    const std::uint64_t fall = kGaussFall[spread], twice = times(fall, fall);
    out[0] = kOne;
    std::uint64_t ratio = fall;
    for (std::size_t k = 1; k < out.size(); ++k, ratio = times(ratio, twice)) out[k] = times(out[k - 1], ratio);
  }
  return out;
}

Tables::Frequencies frequencies(Shape shape, std::size_t spread) {
  const auto weight = weights(shape, spread);
  std::uint64_t sum = shape == Shape::Laplace ? kOne : weight[0];
  for (std::size_t k = 1; k < weight.size() && shape == Shape::Gauss; ++k) sum += 2 * weight[k];
  Tables::Frequencies out{};
  std::uint32_t left = kProbabilityOne - 1;
  out[kEscape] = 1;
  for (int symbol = kEscape - 1; symbol > 0; --symbol) {
    // Below an eighth of the smallest frequency an escape costs less than the room it would take.
    const std::uint64_t eighths = weight[static_cast<std::size_t>(symbol + 1) / 2] * (8 * kProbabilityOne) / sum;
    const auto frequency = static_cast<std::uint16_t>(eighths < 2 ? 0 : (eighths < 12 ? 1 : (eighths + 4) / 8));
    out[static_cast<std::size_t>(symbol)] = frequency;
    left -= frequency;
  }
  out[0] = static_cast<std::uint16_t>(left);
  return out;
}

}  // namespace

const Tables& tables() {
  static const Tables made = [] {
    Tables out;
    for (std::size_t spread = 0; spread < kSpreads; ++spread) {
      out.frequency[spread] = frequencies(Shape::Laplace, spread);
      out.frequency[kSpreads + spread] = frequencies(Shape::Gauss, spread);
    }
    return out;
  }();
  return made;
}

ShiftRule::ShiftRule(const StreamLayout& layout, Attribute attribute) : attribute_(attribute) {
  const float step = layout.at(attribute).quantizer.step;
  const float octaves = layout.at(Attribute::LogScale).quantizer.step * 1.442695F;
  octaves_per_step_ = static_cast<std::int32_t>((octaves > 1.0F ? 1.0F : octaves) * (1 << kFraction) + 0.5F);
  // Found by what gives 50 dB in the fewest bytes: docs/decisions/0110-page-codec.md.
  const auto fine_at = [&](float unit, int cap) {
    constant_ = std::ilogb(unit / step);
    cap_ = cap;
  };
  switch (attribute) {
    case Attribute::Mean:
      constant_ = -std::ilogb(step) - 6;
      cap_ = 10;
      break;
    case Attribute::LogScale:
      fine_at(1.0F / 128, 6);
      break;
    case Attribute::Rotation:
      fine_at(1.0F / 128, 7);
      break;
    case Attribute::Opacity:
      fine_at(1.0F / 3200, 4);
      break;
    case Attribute::Albedo:
      fine_at(1.0F / 200, 6);
      break;
    case Attribute::Visibility:
      break;  // exact: it is the lights' to say, beside the blob
    case Attribute::Residual:
      fine_at(1.0F / 512, 7);
      break;
    case Attribute::Normal:
      fine_at(1.0F / 256, 6);
      break;
    case Attribute::ShDc:
      fine_at(1.0F / 64, 7);
      break;
    case Attribute::ShRest:
      fine_at(1.0F / 128, 7);
      break;
  }
}

Interleaver::Interleaver(const std::array<int, 3>& bits) : part_{} {
  int to = 0;
  for (int bit = 0; bit < kMaxCellBits; ++bit) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      if (bit >= bits[axis]) continue;
      auto& part = part_[axis][static_cast<std::size_t>(bit) / 8];
      for (std::size_t value = 0; value < part.size(); ++value) {
        part[value] |= static_cast<std::uint64_t>(value >> (bit % 8) & 1) << to;
      }
      ++to;
    }
  }
}

Deinterleaver::Deinterleaver(const std::array<int, 3>& bits) : part_{} {
  int from = 0;
  for (int bit = 0; bit < kMaxCellBits; ++bit) {
    for (int axis = 0; axis < 3; ++axis) {
      if (bit >= bits[static_cast<std::size_t>(axis)]) continue;
      auto& part = part_[static_cast<std::size_t>(from) / 8];
      for (std::size_t value = 0; value < part.size(); ++value) {
        part[value] |= static_cast<std::uint64_t>(value >> (from % 8) & 1) << (kMaxCellBits * axis + bit);
      }
      ++from;
    }
  }
}

GapClass gap_class(std::uint64_t gap) {
  const int exponent = std::bit_width(gap + 1) - 1;
  if (exponent == 0) return {};
  return {2 * exponent + static_cast<int>((gap + 1) >> (exponent - 1) & 1), exponent - 1};
}

}  // namespace splatbus::stream::planes

#include "stream/planes/tables.h"

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
    const std::uint64_t eighths =
        weight[static_cast<std::size_t>(symbol + 1) / 2] * (std::uint64_t{8} * kProbabilityOne) / sum;
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

}  // namespace splatbus::stream::planes

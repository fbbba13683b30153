#include "stream/planes/fit.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>

#include "stream/planes/rans.h"

namespace splatbus::stream::planes {

namespace {

// What a few hundred lanes tell of a plane is enough to choose by; neighbours, since vectors take so many at once.
constexpr std::size_t kSample = 256, kNeighbours = 16;

/// Of a residual k: Laplace zero, or first + (k - 1) * further; Gauss zero + further * k^2.
struct Price {
  float zero = 0, first = 0, further = 0, zero_share = 0;
};

const std::array<Price, kTables>& prices() {
  static const std::array<Price, kTables> made = [] {
    std::array<Price, kTables> out;
    for (std::size_t spread = 0; spread < kSpreads; ++spread) {
      const double deviation = 0.1 * std::exp2(static_cast<double>(spread) / 4);
      const double half = std::exp(-1 / (std::sqrt(2.0) * deviation)), whole = half * half;
      double sum = 1;
      for (int k = 1; k < 64; ++k) sum += 2 * std::exp(-k * k / (2 * deviation * deviation));
      const auto set = [](Price& price, double zero, double first, double further, double share) {
        // An escape bounds what a residual costs, and so does the least probability there is.
        price = {static_cast<float>(zero), static_cast<float>(first), static_cast<float>(std::min(further, 12.0)),
                 static_cast<float>(share)};
      };
      set(out[spread], -std::log2(1 - half), -std::log2(0.5 * half * (1 - whole)), -std::log2(whole), 1 - half);
      set(out[kSpreads + spread], std::log2(sum), 0, std::log2(std::exp(1.0)) / (2 * deviation * deviation), 1 / sum);
    }
    return out;
  }();
  return made;
}

/// 2^(slope * shift / 4).
const auto kGrowth = [] {
  std::array<std::array<float, kMaxShift + 1>, 5> out{};
  for (std::size_t slope = 0; slope < out.size(); ++slope) {
    for (std::size_t shift = 0; shift < out[slope].size(); ++shift) {
      out[slope][shift] = static_cast<float>(std::exp2(static_cast<double>(slope * shift) / 4));
    }
  }
  return out;
}();

/// The nearest spread of a deviation, or one beside it.
int about_spread(float deviation) {
  const float above = std::max(deviation * 10, 1.0F);
  // The bits of a float as a number are its binary logarithm, nearly.
  const auto octaves = static_cast<float>(std::bit_cast<std::uint32_t>(above) - (127U << 23U)) * 0x1p-23F;
  return std::clamp(static_cast<int>(4 * octaves + 0.7F), 0, kMaxSpread - 1);
}

}  // namespace

PlaneFitter::PlaneFitter(std::size_t count) : count_(count), no_shift_(count), residuals_(count) {
  const std::size_t step = std::max<std::size_t>(1, count / kSample) * kNeighbours;
  std::size_t lanes = 0;
  for (std::size_t from = 0; from < count; from += step) {
    sampled_.emplace_back(from, std::min(count, from + kNeighbours));
    lanes += sampled_.back().second - from;
  }
  sample_shift_.resize(lanes);
  sample_context_.resize(lanes);
  difference_.resize(lanes);
}

void PlaneFitter::begin(const Lanes& lanes, Effort effort) {
  lanes_ = lanes;
  effort_ = effort;
  at_shift_ = {};
  std::size_t to = 0;
  for (const auto& [from, end] : sampled_) {
    for (std::size_t i = from; i < end; ++i, ++to) {
      sample_shift_[to] = lanes.shift[i];
      sample_context_[to] = lanes.context[i];
      ++at_shift_[lanes.shift[i]];
    }
  }
}

void PlaneFitter::sample(Predictor predictor, const Before& before, const std::int32_t* plane) {
  PlaneModel model;
  model.predictor = predictor;
  std::size_t to = 0;
  for (const auto& [from, end] : sampled_) {
    values_to_residuals(model, {no_shift_.data(), no_shift_.data()}, before, plane, from, end, difference_.data() + to);
    to += end - from;
  }
}

std::int32_t PlaneFitter::mean_difference() const {
  std::int64_t sum = 0;
  for (const std::int32_t difference : difference_) sum += difference;
  return static_cast<std::int32_t>(std::lround(static_cast<double>(sum) / static_cast<double>(difference_.size())));
}

PlaneModel PlaneFitter::regression() const {
  double classes = 0, class_squares = 0, products = 0, values = 0;
  const auto count = static_cast<double>(difference_.size());
  for (std::size_t j = 0; j < difference_.size(); ++j) {
    const double k = int{sample_context_[j]} - kClassBias, value = difference_[j];
    classes += k;
    class_squares += k * k;
    products += k * value;
    values += value;
  }
  const double variance = class_squares - classes * classes / count;
  const double per_class = variance > 0 ? (products - classes * values / count) / variance : 0;
  PlaneModel model;
  model.predictor = Predictor::Offset;
  model.offset = static_cast<std::int32_t>(std::lround((values - per_class * classes) / count));
  model.per_class = static_cast<std::int32_t>(std::clamp(std::round(8 * per_class), -1e6, 1e6));
  return model;
}

void PlaneFitter::measure(const PlaneModel& model) {
  constexpr std::size_t kTurns = 4;  // so that lanes do not wait for the sums of the one before
  struct Sums {
    std::uint64_t zeros_magnitude = 0, square = 0;
  };
  Sums sums[kTurns][kMaxShift + 1] = {};
  for (std::size_t j = 0; j < difference_.size(); ++j) {
    const int shift = sample_shift_[j];
    std::int32_t offset = model.offset;
    if (model.per_class != 0) offset += model.per_class * (int{sample_context_[j]} - kClassBias) / 8;
    // Of a multiple of 2^shift what values_to_residuals() gives.
    const std::int64_t residual = (offset + ((1 << shift) >> 1) - difference_[j]) >> shift;
    const auto magnitude = static_cast<std::uint64_t>(residual < 0 ? -residual : residual);
    Sums& sum = sums[j % kTurns][shift];
    sum.zeros_magnitude += magnitude | std::uint64_t{magnitude == 0} << 48U;
    sum.square += magnitude * magnitude;
  }
  used_shifts_ = 0;
  for (std::size_t shift = 0; shift < at_shift_.size(); ++shift) {
    if (at_shift_[shift] == 0) continue;
    std::uint64_t zeros_magnitude = 0, square = 0;
    for (const auto& turn : sums) {
      zeros_magnitude += turn[shift].zeros_magnitude;
      square += turn[shift].square;
    }
    moments_[used_shifts_++] = {static_cast<int>(shift), static_cast<float>(at_shift_[shift]),
                                static_cast<float>(zeros_magnitude >> 48U),
                                static_cast<float>(zeros_magnitude & 0xFFFF'FFFF'FFFFU), static_cast<float>(square)};
  }
}

float PlaneFitter::cost(Shape shape, int slope, int spread) const {
  float bits = 0;
  for (std::size_t k = 0; k < used_shifts_; ++k) {
    const Moments& m = moments_[k];
    const Spread at = spread_of(spread - slope * m.shift);
    const auto scale = std::bit_cast<float>(static_cast<std::uint32_t>(127 - at.low_bits) << 23U);
    bits += static_cast<float>(at.low_bits) * m.count;
    if (shape == Shape::Laplace) {
      const Price& price = prices()[static_cast<std::size_t>(at.table)];
      const float zeros = at.low_bits == 0 ? m.zeros : m.count * price.zero_share;
      const float others = m.count - zeros;
      bits += zeros * price.zero + others * price.first + std::max(0.0F, m.magnitude * scale - others) * price.further;
    } else {
      const Price& price = prices()[kSpreads + static_cast<std::size_t>(at.table)];
      bits += m.count * price.zero + m.square * scale * scale * price.further;
    }
  }
  return bits;
}

float PlaneFitter::choose(PlaneModel& model) const {
  float least = std::numeric_limits<float>::infinity();
  const auto attempt = [&](Shape shape, int slope) {
    float count = 0, magnitude = 0, square = 0;
    for (std::size_t k = 0; k < used_shifts_; ++k) {
      const Moments& m = moments_[k];
      const float grow = kGrowth[static_cast<std::size_t>(slope)][static_cast<std::size_t>(m.shift)];
      count += m.count;
      magnitude += m.magnitude * grow;
      square += m.square * grow * grow;
    }
    int spread = about_spread(shape == Shape::Laplace ? 1.41421356F * magnitude / count : std::sqrt(square / count));
    float bits = cost(shape, slope, spread);
    for (const int step : {-1, 1}) {
      bool moved = false;
      for (int next = spread + step; next >= 0 && next < kMaxSpread; next += step) {
        const float there = cost(shape, slope, next);
        if (there >= bits) break;
        bits = there;
        spread = next;
        moved = true;
      }
      if (moved) break;
    }
    if (bits >= least) return false;
    least = bits;
    model.shape = shape;
    model.slope = slope;
    model.spread = spread;
    return true;
  };
  for (int slope = 4; slope >= (used_shifts_ > 1 ? 2 : 4) && attempt(Shape::Laplace, slope); --slope) {
  }
  attempt(Shape::Gauss, model.slope);
  return least;
}

PlaneModel PlaneFitter::fit(const Before& before, const std::int32_t* plane) {
  PlaneModel best;
  const auto [low, high] = range_of(plane, count_);
  if (low == high) {
    best.offset = low;
    return best;
  }
  float least = std::numeric_limits<float>::infinity();
  const auto attempt = [&](PlaneModel model) {
    measure(model);
    const float bits = choose(model);
    if (bits >= least) return;
    least = bits;
    best = model;
  };
  const auto attempt_with = [&](Predictor predictor, bool has_offset) {
    sample(predictor, before, plane);
    PlaneModel model;
    model.predictor = predictor;
    if (has_offset) model.offset = mean_difference();
    attempt(model);
  };
  attempt_with(Predictor::Offset, true);
  if (effort_ == Effort::All) {
    if (const PlaneModel own = regression(); own.per_class != 0) attempt(own);
  }
  if (effort_ != Effort::OwnOnly && before.last != nullptr) {
    attempt_with(Predictor::Channel, true);
    if (effort_ == Effort::All) attempt_with(Predictor::Both, false);
  }
  if (effort_ == Effort::All) attempt_with(Predictor::Lane, false);
  values_to_residuals(best, lanes_, before, plane, 0, count_, residuals_.data());
  return best;
}

}  // namespace splatbus::stream::planes

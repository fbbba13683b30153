#include "stream/page_plane_fit.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>

namespace splatbus::stream::planes {

namespace {

/// Of a residual k: Laplace zero, or first + (k - 1) * further; Gauss zero + further * k^2.
struct Price {
  double zero = 0, first = 0, further = 0, zero_share = 0;
};

const std::array<Price, kTables>& prices() {
  static const std::array<Price, kTables> made = [] {
    std::array<Price, kTables> out;
    for (std::size_t spread = 0; spread < kSpreads; ++spread) {
      const double deviation = 0.1 * std::exp2(static_cast<double>(spread) / 4);
      const double half = std::exp(-1 / (std::sqrt(2.0) * deviation)), whole = half * half;
      Price& laplace = out[spread];
      laplace = {-std::log2(1 - half), -std::log2(0.5 * half * (1 - whole)), -std::log2(whole), 1 - half};
      double sum = 1;
      for (int k = 1; k < 64; ++k) sum += 2 * std::exp(-k * k / (2 * deviation * deviation));
      out[kSpreads + spread] = {std::log2(sum), 0, std::log2(std::exp(1.0)) / (2 * deviation * deviation), 1 / sum};
    }
    // An escape bounds what a residual costs, and so does the least probability there is.
    for (Price& price : out) price.further = std::min(price.further, 12.0);
    return out;
  }();
  return made;
}

/// 2^(slope * shift / 4).
const auto kGrowth = [] {
  std::array<std::array<double, kMaxShift + 1>, 5> out{};
  for (std::size_t slope = 0; slope < out.size(); ++slope) {
    for (std::size_t shift = 0; shift < out[slope].size(); ++shift) {
      out[slope][shift] = std::exp2(static_cast<double>(slope * shift) / 4);
    }
  }
  return out;
}();

std::int32_t halfway_round(std::int32_t predicted, int shift) {
  return (predicted + ((1 << shift) >> 1)) >> shift;
}

}  // namespace

std::vector<std::uint8_t> classes_of(const QuantizedGaussians& page, const StreamLayout& layout) {
  const std::size_t count = page.count();
  std::vector<int> highest(count, kClasses - 1 - kClassBias);
  std::vector<std::uint32_t> any(count);
  std::vector<ShiftRule> rules;
  const auto scale = static_cast<std::size_t>(layout.at(Attribute::LogScale).first);
  const auto& x = page.channels[scale];
  const auto& y = page.channels[scale + 1];
  const auto& z = page.channels[scale + 2];
  for (const AttributeChannels& a : layout.attributes()) {
    const ShiftRule& rule = rules.emplace_back(layout, a.attribute);
    std::fill(any.begin(), any.end(), 0U);
    for (int c = 0; c < a.channels; ++c) {
      const auto& plane = page.channels[static_cast<std::size_t>(a.first + c)];
      for (std::size_t i = 0; i < count; ++i) any[i] |= static_cast<std::uint32_t>(plane[i]);
    }
    for (std::size_t i = 0; i < count; ++i) {
      const int zeros = std::countr_zero(any[i]);
      if (zeros < rule.cap()) highest[i] = std::min(highest[i], zeros - rule.offset(x[i], y[i], z[i]));
    }
  }
  std::vector<std::uint8_t> out(count);
  std::size_t shifts = 0;
  for (std::size_t i = 0; i < count; ++i) {
    out[i] = static_cast<std::uint8_t>(std::clamp(highest[i] + kClassBias, 0, kClasses - 1));
    for (const ShiftRule& rule : rules) {
      shifts += static_cast<std::size_t>(shift_at(out[i] - kClassBias, rule.offset(x[i], y[i], z[i]), rule.cap()));
    }
  }
  if (shifts < count) std::fill(out.begin(), out.end(), std::uint8_t{0});
  return out;
}

std::vector<std::uint8_t> shifts_of(const QuantizedGaussians& page, const StreamLayout& layout, Attribute attribute,
                                    const std::vector<std::uint8_t>& klass) {
  const ShiftRule rule(layout, attribute);
  const auto scale = static_cast<std::size_t>(layout.at(Attribute::LogScale).first);
  std::vector<std::uint8_t> out(klass.size());
  for (std::size_t i = 0; i < out.size(); ++i) {
    const int offset = rule.offset(page.channels[scale][i], page.channels[scale + 1][i], page.channels[scale + 2][i]);
    out[i] = static_cast<std::uint8_t>(shift_at(klass[i] - kClassBias, offset, rule.cap()));
  }
  return out;
}

double PlaneFitter::choose(PlaneModel& model, const MomentsOfShift& moments) {
  const auto cost_of = [&](int shape, int slope, int spread) {
    double bits = 0;
    for (std::size_t shift = 0; shift < moments.size(); ++shift) {
      const Moments& m = moments[shift];
      if (m.count == 0) continue;
      const auto magnitude = static_cast<double>(m.magnitude), counted = static_cast<double>(m.count);
      const Spread at = spread_of(spread - slope * static_cast<int>(shift));
      const Price& price = prices()[static_cast<std::size_t>(shape * kSpreads + at.table)];
      const double scale = 1.0 / static_cast<double>(std::uint64_t{1} << at.low_bits);
      bits += at.low_bits * counted;
      if (shape == 0) {
        const double zeros = at.low_bits == 0 ? static_cast<double>(m.zeros) : counted * price.zero_share;
        const double others = counted - zeros;
        bits += zeros * price.zero + others * price.first + std::max(0.0, magnitude * scale - others) * price.further;
      } else {
        bits += counted * price.zero + m.square * scale * scale * price.further;
      }
    }
    return bits;
  };
  int used = 0;
  for (const Moments& m : moments) used += m.count > 0 ? 1 : 0;
  double least = INFINITY;
  for (int slope = 4; slope >= (used > 1 ? 2 : 4); --slope) {
    double count = 0, magnitude = 0, square = 0;
    for (std::size_t shift = 0; shift < moments.size(); ++shift) {
      if (moments[shift].count == 0) continue;
      const double grow = kGrowth[static_cast<std::size_t>(slope)][shift];
      count += static_cast<double>(moments[shift].count);
      magnitude += static_cast<double>(moments[shift].magnitude) * grow;
      square += moments[shift].square * grow * grow;
    }
    for (int shape = 0; shape < 2; ++shape) {
      const double deviation = shape == 0 ? std::sqrt(2.0) * magnitude / count : std::sqrt(square / count);
      const auto bounded = [](int spread) { return std::clamp(spread, 0, kMaxSpread - 1); };
      int spread = bounded(static_cast<int>(std::lround(4 * std::log2(std::max(deviation, 0.1) / 0.1))));
      double cost = cost_of(shape, slope, spread);
      for (const int step : {-1, 1}) {
        for (int next = bounded(spread + step); next != spread; next = bounded(spread + step)) {
          const double there = cost_of(shape, slope, next);
          if (there >= cost) break;
          cost = there;
          spread = next;
        }
      }
      if (cost < least) {
        least = cost;
        model.shape = static_cast<Shape>(shape);
        model.slope = slope;
        model.spread = spread;
      }
    }
  }
  return least;
}

template <class Take>
void PlaneFitter::predict(const PlaneModel& model, const Lanes& lanes,
                          std::span<const std::vector<std::int32_t>> before, const std::vector<std::int32_t>& plane,
                          std::size_t stride, Take take) {
  const std::size_t count = plane.size();
  const auto each = [&](auto base) {
    std::array<std::int32_t, kClasses> offset;
    for (int k = 0; k < kClasses; ++k) {
      offset[static_cast<std::size_t>(k)] = model.offset + (model.per_class * (k - kClassBias)) / 8;
    }
    for (std::size_t i = 0; i < count; i += stride) {
      const std::uint8_t k = lanes.context[i];
      const int shift = lanes.shift[k];
      take(i, shift, (plane[i] >> shift) - halfway_round(base(i) + offset[k], shift));
    }
  };
  const std::size_t colour = before.size() % 3;
  switch (model.predictor) {
    case Predictor::Constant:
    case Predictor::Offset:
      each([](std::size_t) { return 0; });
      break;
    case Predictor::Lane:
      each([&](std::size_t i) { return i > 0 ? plane[i - 1] : 0; });
      break;
    case Predictor::Channel: {
      const std::int32_t* const a = before.back().data();
      const std::int32_t* const b = before[before.size() - colour].data();
      each([&](std::size_t i) { return (a[i] + b[i]) >> 1; });
      break;
    }
    case Predictor::Both: {
      const std::int32_t* const a = before.back().data();
      each([&](std::size_t i) { return i > 0 ? plane[i - 1] + a[i] - a[i - 1] : a[0]; });
      break;
    }
  }
}

PlaneModel PlaneFitter::fit(const Lanes& lanes, std::span<const std::vector<std::int32_t>> before,
                            const std::vector<std::int32_t>& plane, Effort effort) {
  PlaneModel best;
  std::int32_t low = plane[0], high = plane[0];
  std::int64_t sum = 0;
  for (const std::int32_t value : plane) {
    low = std::min(low, value);
    high = std::max(high, value);
    sum += value;
  }
  if (low == high) {
    best.offset = low;
    return best;
  }
  const auto mean_of = [&](std::int64_t of) {
    return static_cast<std::int32_t>(std::llround(static_cast<double>(of) / static_cast<double>(plane.size())));
  };
  // What a few hundred lanes tell of a plane is enough to choose by.
  const std::size_t stride = std::max<std::size_t>(1, plane.size() / kSample);
  double least = INFINITY;
  const auto attempt = [&](PlaneModel model) {
    MomentsOfShift moments{};
    predict(model, lanes, before, plane, stride, [&](std::size_t, int shift, std::int32_t residual) {
      Moments& m = moments[static_cast<std::size_t>(shift)];
      const std::int64_t wide = residual;
      m.count += 1;
      m.zeros += residual == 0 ? 1 : 0;
      m.magnitude += wide < 0 ? -wide : wide;
      m.square += static_cast<double>(wide * wide);
    });
    const double cost = choose(model, moments);
    if (cost < least) {
      least = cost;
      best = model;
    }
  };
  const auto with = [](Predictor predictor, std::int32_t offset) {
    PlaneModel model;
    model.predictor = predictor;
    model.offset = offset;
    return model;
  };
  attempt(with(Predictor::Offset, mean_of(sum)));
  if (effort == Effort::All) {
    double classes = 0, class_squares = 0, products = 0, values = 0, count = 0;
    for (std::size_t i = 0; i < plane.size(); i += stride) {
      const double k = int{lanes.context[i]} - kClassBias, value = plane[i];
      classes += k;
      class_squares += k * k;
      products += k * value;
      values += value;
      count += 1;
    }
    const double variance = class_squares - classes * classes / count;
    const double per_class = variance > 0 ? (products - classes * values / count) / variance : 0;
    PlaneModel own =
        with(Predictor::Offset, static_cast<std::int32_t>(std::llround((values - per_class * classes) / count)));
    own.per_class = static_cast<std::int32_t>(std::clamp(std::round(8 * per_class), -1e6, 1e6));
    if (own.per_class != 0) attempt(own);
  }
  if (effort != Effort::OwnOnly && before.size() % 3 != 0) {
    const std::vector<std::int32_t>& a = before.back();
    const std::vector<std::int32_t>& b = before[before.size() - before.size() % 3];
    std::int64_t more = sum;
    for (std::size_t i = 0; i < plane.size(); ++i) more -= (a[i] + b[i]) >> 1;
    attempt(with(Predictor::Channel, mean_of(more)));
    if (effort == Effort::All) attempt(with(Predictor::Both, 0));
  }
  if (effort == Effort::All) attempt(with(Predictor::Lane, 0));
  std::int32_t* const out = residuals_.data();
  predict(best, lanes, before, plane, 1, [out](std::size_t i, int, std::int32_t residual) { out[i] = residual; });
  return best;
}

}  // namespace splatbus::stream::planes

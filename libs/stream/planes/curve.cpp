#include "stream/planes/curve.h"

#include <algorithm>
#include <bit>
#include <cassert>
#include <limits>
#include <numeric>
#include <utility>

#include "stream/codecs.h"
#include "stream/page_codec.h"
#include "stream/planes/predict.h"
#include "stream/planes/shifts.h"

namespace splatbus::stream {

namespace planes {

namespace {

// Gaps that are looked at to choose by.
constexpr std::size_t kKeysSampled = 256;

int widest_of(const std::array<int, 3>& bits) {
  return std::max({bits[0], bits[1], bits[2]});
}

/// Stable. Leaves `keys` ascending.
std::vector<std::uint32_t> sort(std::vector<std::uint64_t>& keys) {
  std::vector<std::uint32_t> order(keys.size());
  std::iota(order.begin(), order.end(), 0U);
  if (std::ranges::is_sorted(keys)) return order;
  static_assert(kMaxPageGaussians <= 1U << 12U);
  if (std::ranges::max(keys) >> 52U == 0) {
    // Key and place in one number.
    for (std::size_t i = 0; i < keys.size(); ++i) keys[i] = keys[i] << 12U | i;
    std::ranges::sort(keys);
    for (std::size_t i = 0; i < keys.size(); ++i) {
      order[i] = static_cast<std::uint32_t>(keys[i] & 0xFFFU);
      keys[i] >>= 12U;
    }
    return order;
  }
  std::ranges::stable_sort(order, {}, [&](std::uint32_t i) { return keys[i]; });
  std::ranges::sort(keys);
  return order;
}

}  // namespace

Curve sorted_curve(const QuantizedGaussians& page, const AttributeChannels& mean,
                   const std::optional<MeanOrigin>& origin) {
  Curve curve;
  const std::size_t count = page.count();
  const auto first = static_cast<std::size_t>(mean.first);
  std::array<const std::int32_t*, 3> means{};
  for (std::size_t axis = 0; axis < 3; ++axis) {
    means[axis] = page.channels[first + axis].data();
    auto [low, high] = range_of(means[axis], count);
    if (origin) low = std::min(low, (*origin)[axis]);
    curve.grid.origin[axis] = low >> kMaxShift << kMaxShift;
    curve.extent_bits_[axis] = std::bit_width(static_cast<std::uint32_t>(high - curve.grid.origin[axis]));
  }
  const int widest = widest_of(curve.extent_bits_);
  curve.finest_ = std::max(0, widest - kMaxCellBits);
  for (std::size_t axis = 0; axis < 3; ++axis) {
    // Wide enough for the coarsest grid, too, so that the order is that of all.
    curve.grid.bits[axis] = std::max(curve.extent_bits_[axis], std::min(kMaxLowBits, widest)) - curve.finest_;
  }
  curve.grid.low = curve.finest_;
  const Interleaver interleave(curve.grid.bits);
  curve.keys_.resize(count);
  for (std::size_t i = 0; i < count; ++i) {
    std::array<std::uint32_t, 3> cell{};
    for (std::size_t axis = 0; axis < 3; ++axis) {
      cell[axis] = static_cast<std::uint32_t>(means[axis][i] - curve.grid.origin[axis]) >> curve.finest_;
    }
    curve.keys_[i] = interleave(cell);
  }
  curve.order = sort(curve.keys_);
  return curve;
}

void Curve::choose_low_bits(std::span<const std::uint8_t> shift) {
  std::array<std::uint32_t, kMaxShift + 1> at_shift{};
  for (const std::uint8_t s : shift) ++at_shift[s];
  std::vector<std::pair<std::uint64_t, std::uint64_t>> sampled;  // keys from and to
  const std::size_t step = std::max<std::size_t>(1, keys_.size() / kKeysSampled);
  for (std::size_t i = 0; i < keys_.size(); i += step) sampled.emplace_back(i > 0 ? keys_[i - 1] : 0, keys_[i]);
  const double lanes_a_sample = static_cast<double>(keys_.size()) / static_cast<double>(sampled.size());
  const int coarsest = std::min(kMaxLowBits, widest_of(extent_bits_));
  double least = std::numeric_limits<double>::infinity();
  for (int low = finest_; low <= coarsest; ++low) {
    double cost = 0;
    for (int s = 0; s < low && s <= kMaxShift; ++s) cost += 3.0 * (low - s) * at_shift[static_cast<std::size_t>(s)];
    int gap_bits = 0;
    for (const auto& [from, to] : sampled) {
      const int coarser = 3 * (low - finest_);
      // What the class says besides is much the same.
      gap_bits += std::max(0, static_cast<int>(std::bit_width((to >> coarser) - (from >> coarser) + 1)) - 2);
    }
    cost += lanes_a_sample * gap_bits;
    if (cost < least) {
      least = cost;
      grid.low = low;
    }
  }
  for (std::size_t axis = 0; axis < 3; ++axis) grid.bits[axis] = std::max(0, extent_bits_[axis] - grid.low);
}

}  // namespace planes

std::vector<std::uint32_t> page_order(const QuantizedGaussians& page, const StreamLayout& layout, PageCodec codec) {
  std::vector<std::uint32_t> order(page.count());
  std::iota(order.begin(), order.end(), 0U);
  if (page.count() == 0) return order;
  if (codec == PageCodec::Draco) return morton_order(page, layout, order);
  return planes::sorted_curve(page, layout.at(Attribute::Mean), {}).order;
}

std::array<std::int32_t, 3> mean_origin(const QuantizedGaussians& page, const StreamLayout& layout) {
  assert(page.count() > 0);
  const auto first = static_cast<std::size_t>(layout.at(Attribute::Mean).first);
  std::array<std::int32_t, 3> origin{};
  for (std::size_t axis = 0; axis < 3; ++axis) origin[axis] = *std::ranges::min_element(page.channels[first + axis]);
  return origin;
}

}  // namespace splatbus::stream

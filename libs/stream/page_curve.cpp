#include "stream/page_curve.h"

#include <algorithm>
#include <bit>
#include <cassert>
#include <cmath>
#include <numeric>

#include "stream/codecs.h"
#include "stream/page_codec.h"

namespace splatbus::stream {

namespace planes {

namespace {

/// Bits of the means above their origin, by axis.
struct Extent {
  std::array<int, 3> bits{};
  int widest = 0;
  /// The curve at its finest leaves out so many; a coarser one has the same order.
  [[nodiscard]] int finest() const { return std::max(0, widest - kMaxCellBits); }
  [[nodiscard]] int coarsest() const { return std::min(kMaxLowBits, widest); }
};

Extent extent_of(const QuantizedGaussians& page, std::size_t first, const MeanOrigin& origin) {
  Extent extent;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const std::int32_t high = *std::ranges::max_element(page.channels[first + axis]);
    extent.bits[axis] = std::bit_width(static_cast<std::uint32_t>(high - origin[axis]));
    extent.widest = std::max(extent.widest, extent.bits[axis]);
  }
  return extent;
}

}  // namespace

Curve sorted_curve(const QuantizedGaussians& page, const AttributeChannels& mean,
                   const std::optional<MeanOrigin>& origin) {
  Curve curve;
  const std::size_t count = page.count();
  const auto first = static_cast<std::size_t>(mean.first);
  for (std::size_t axis = 0; axis < 3; ++axis) {
    std::int32_t low = *std::ranges::min_element(page.channels[first + axis]);
    if (origin) low = std::min(low, (*origin)[axis]);
    curve.grid.origin[axis] = low >> kMaxShift << kMaxShift;
  }
  const Extent extent = extent_of(page, first, curve.grid.origin);
  const int finest = extent.finest();
  for (std::size_t axis = 0; axis < 3; ++axis) {
    curve.grid.bits[axis] = std::max(extent.bits[axis], extent.coarsest()) - finest;
  }
  curve.grid.low = finest;
  const Interleaver interleave(curve.grid.bits);
  curve.order.reserve(count);
  for (std::uint32_t i = 0; i < count; ++i) {
    std::array<std::uint32_t, 3> cell{};
    for (std::size_t axis = 0; axis < 3; ++axis) {
      cell[axis] = static_cast<std::uint32_t>(page.channels[first + axis][i] - curve.grid.origin[axis]) >> finest;
    }
    curve.order.emplace_back(interleave(cell), i);
  }
  std::ranges::sort(curve.order);
  return curve;
}

Curve curve_of(const QuantizedGaussians& page, const AttributeChannels& mean, const std::optional<MeanOrigin>& origin,
               const std::vector<std::uint8_t>& shift) {
  Curve curve = sorted_curve(page, mean, origin);
  const Extent extent = extent_of(page, static_cast<std::size_t>(mean.first), curve.grid.origin);
  std::array<std::uint32_t, kMaxShift + 1> at_shift{};
  for (const std::uint8_t s : shift) ++at_shift[s];
  double least = INFINITY;
  for (int low = extent.finest(); low <= extent.coarsest(); ++low) {
    double cost = 0;
    for (int s = 0; s < low && s <= kMaxShift; ++s) cost += 3.0 * (low - s) * at_shift[static_cast<std::size_t>(s)];
    std::uint64_t before = 0;
    for (const auto& [key, column] : curve.order) {
      const std::uint64_t at = key >> (3 * (low - extent.finest()));
      cost += std::max(
          0, static_cast<int>(std::bit_width(at - before + 1)) - 2);  // what the class says besides is much the same
      before = at;
    }
    if (cost < least) {
      least = cost;
      curve.grid.low = low;
    }
  }
  for (std::size_t axis = 0; axis < 3; ++axis) {
    curve.grid.bits[axis] = std::max(0, extent.bits[axis] - curve.grid.low);
  }
  return curve;
}

}  // namespace planes

std::vector<std::uint32_t> page_order(const QuantizedGaussians& page, const StreamLayout& layout, PageCodec codec) {
  std::vector<std::uint32_t> order(page.count());
  std::iota(order.begin(), order.end(), 0U);
  if (page.count() == 0) return order;
  if (codec == PageCodec::Draco) return morton_order(page, layout, order);
  const planes::Curve curve = planes::sorted_curve(page, layout.at(Attribute::Mean), {});
  std::ranges::transform(curve.order, order.begin(), [](const auto& entry) { return entry.second; });
  return order;
}

std::array<std::int32_t, 3> mean_origin(const QuantizedGaussians& page, const StreamLayout& layout) {
  assert(page.count() > 0);
  const auto first = static_cast<std::size_t>(layout.at(Attribute::Mean).first);
  std::array<std::int32_t, 3> origin{};
  for (std::size_t axis = 0; axis < 3; ++axis) origin[axis] = *std::ranges::min_element(page.channels[first + axis]);
  return origin;
}

}  // namespace splatbus::stream

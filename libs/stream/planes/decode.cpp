#include <algorithm>
#include <cstddef>
#include <cstdlib>
#include <limits>

#include "stream/page_codec_parts.h"
#include "stream/planes/morton.h"
#include "stream/planes/source.h"

namespace splatbus::stream {

namespace planes {

namespace {

std::int32_t read_number(ByteReader& header) {
  const std::int64_t value = unzigzag(header.varint());
  if (value < -(1 << 28) || value > 1 << 28) refuse("a number out of any range");
  return static_cast<std::int32_t>(value);
}

PlaneModel read_model(ByteReader& header) {
  const std::uint64_t kind = header.low_bytes(1);
  if ((kind & 7U) >= kPredictors || kind >= 128) refuse("an unknown predictor");
  PlaneModel model;
  model.predictor = static_cast<Predictor>(kind & 7U);
  model.shape = static_cast<Shape>(kind >> 3U & 1U);
  model.slope = 1 + static_cast<int>(kind >> 4U & 3U);
  model.spread = static_cast<int>(header.low_bytes(1));
  if (model.spread >= kMaxSpread) refuse("values that are wider than any");
  model.offset = read_number(header);
  if ((kind >> 6U & 1U) != 0) {
    model.per_class = read_number(header);
    if (std::abs(model.per_class) > 1 << 20) refuse("a number out of any range");
  }
  return model;
}

/// One plane into `out` [count].
void read_plane(Source& source, const Lanes& lanes, const Before& before, std::int32_t* out) {
  const PlaneModel model = read_model(source.header());
  if (model.predictor == Predictor::Constant) {
    std::fill_n(out, source.count(), model.offset);
    return;
  }
  if ((model.predictor == Predictor::Channel || model.predictor == Predictor::Both) && before.last == nullptr) {
    refuse("a first channel that is predicted from one before");
  }
  source.residuals(model, lanes.shift, out);
  residuals_to_values(model, lanes, before, source.count(), out);
}

/// A plane by itself.
void read_alone(Source& source, std::vector<std::int32_t>& out) {
  const std::vector<std::uint8_t> none(source.count());
  read_plane(source, {none.data(), none.data()}, {}, out.data());
}

void require_limits(const AttributeChannels& a, const std::vector<std::int32_t>& plane) {
  const auto [low, high] = range_of(plane.data(), plane.size());
  if (low < a.minimum || high > a.maximum) refuse("a value beyond its limits");
}

/// Numbers from 0 that ascend in size rather than value.
std::vector<std::uint64_t> read_gaps(Source& source) {
  std::vector<std::int32_t> number(source.count());
  read_alone(source, number);
  std::vector<std::uint64_t> gaps(source.count());
  for (std::size_t i = 0; i < gaps.size(); ++i) {
    if (number[i] < 0 || number[i] > kMaxGapClass) refuse("a gap wider than any");
    const int bits = gap_plain_bits(number[i]), low = bits < 32 ? bits : 32;
    std::uint64_t plain = source.plain(low);
    if (bits > low) plain |= std::uint64_t{source.plain(bits - low)} << 32U;
    gaps[i] = gap_base(number[i]) + plain - 1;
  }
  source.check();
  return gaps;
}

void read_means(Source& source, const AttributeChannels& a, std::span<const std::uint8_t> shift,
                std::span<std::vector<std::int32_t>> out) {
  ByteReader& header = source.header();
  MortonGrid grid;
  for (std::int32_t& origin : grid.origin) origin = read_number(header);
  for (int& bits : grid.bits) {
    bits = static_cast<int>(header.low_bytes(1));
    if (bits > kMaxCellBits) refuse("an axis of too many bits");
  }
  grid.low = static_cast<int>(header.low_bytes(1));
  if (grid.low > kMaxLowBits) refuse("an axis of too many bits");
  const std::vector<std::uint64_t> gaps = read_gaps(source);
  const Deinterleaver cells(grid.bits);
  constexpr std::uint64_t kAxis = (std::uint64_t{1} << kMaxCellBits) - 1;
  std::uint64_t key = 0;
  for (std::size_t i = 0; i < gaps.size(); ++i) {
    key += gaps[i];
    const std::uint64_t cell = cells(key);
    const int plain = grid.low > shift[i] ? grid.low - shift[i] : 0;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const auto high = static_cast<std::uint32_t>(cell >> (kMaxCellBits * axis) & kAxis);
      const std::uint32_t low = plain > 0 ? source.plain(plain) << shift[i] : 0;
      out[axis][i] =
          static_cast<std::int32_t>(static_cast<std::uint32_t>(grid.origin[axis]) + (high << grid.low) + low);
    }
  }
  source.check();
  for (const auto& plane : out) require_limits(a, plane);
}

std::vector<std::uint32_t> read_object_ids(Source& source, bool one) {
  ByteReader& header = source.header();
  std::vector<std::uint32_t> ids;
  ids.reserve(source.count());
  while (ids.size() < source.count()) {
    const std::uint64_t length = one ? source.count() : header.varint() + 1, id = header.varint();
    if (id > std::numeric_limits<std::uint32_t>::max()) refuse("an object id of more than 32 bits");
    if (length == 0 || length > source.count() - ids.size()) refuse("more objects' Gaussians than it has");
    ids.insert(ids.end(), length, static_cast<std::uint32_t>(id));
  }
  return ids;
}

/// [lanes in the order of the blob] of where they go.
std::vector<std::uint32_t> read_order(Source& source) {
  const std::vector<std::uint64_t> places = read_gaps(source);
  std::vector<std::uint32_t> left, order;
  left.reserve(places.size());
  order.reserve(places.size());
  for (std::size_t i = places.size(); i > 0; --i) left.push_back(static_cast<std::uint32_t>(i - 1));
  for (const std::uint64_t place : places) {
    if (place >= left.size()) refuse("a lane beyond its last");
    const auto at = left.end() - 1 - static_cast<std::ptrdiff_t>(place);
    order.push_back(*at);
    left.erase(at);
  }
  return order;
}

QuantizedGaussians scatter(const QuantizedGaussians& lanes, const std::vector<std::uint32_t>& order) {
  std::vector<std::uint32_t> from(order.size());
  for (std::uint32_t i = 0; i < order.size(); ++i) from[order[i]] = i;
  return lanes.gather(from);
}

}  // namespace

}  // namespace planes

QuantizedGaussians decode_planes(std::span<const std::uint8_t> bytes, const StreamLayout& layout, std::size_t count) {
  using namespace planes;
  if (bytes.size() < 2 || bytes[0] != kFormat) refuse("not of this format");
  const std::uint8_t flags = bytes[1];
  if (flags > (kHasIds | kOneObject | kOwnOrder)) refuse("unknown flags");
  Source source(bytes.subspan(2), count);
  QuantizedGaussians out(layout, count);

  std::vector<std::uint8_t> klass(count), shift(count);
  {
    std::vector<std::int32_t> plane(count);
    read_alone(source, plane);
    for (std::size_t i = 0; i < count; ++i) {
      if (plane[i] < 0 || plane[i] >= kClasses) refuse("an unknown class of precision");
      klass[i] = static_cast<std::uint8_t>(plane[i]);
    }
  }
  const auto planes_of = [&](const AttributeChannels& a) {
    return std::span(out.channels).subspan(static_cast<std::size_t>(a.first), static_cast<std::size_t>(a.channels));
  };
  const auto read_attribute = [&](const AttributeChannels& a) {
    const ShiftRule rule(layout, a.attribute);
    const auto scale = planes_of(layout.at(Attribute::LogScale));
    const std::int32_t* const size[3] = {scale[0].data(), scale[1].data(), scale[2].data()};
    put_shifts(rule, klass, size, shift.data());
    const auto planes = planes_of(a);
    if (a.attribute == Attribute::Mean) return read_means(source, a, shift, planes);
    const Lanes lanes{shift.data(), rule.is_constant() ? klass.data() : shift.data()};
    for (std::size_t c = 0; c < planes.size(); ++c) {
      const std::size_t colour = c % 3;
      const Before before = colour == 0 ? Before{} : Before{planes[c - 1].data(), planes[c - colour].data()};
      read_plane(source, lanes, before, planes[c].data());
      require_limits(a, planes[c]);
    }
  };
  read_attribute(layout.at(Attribute::LogScale));  // means and rotations are as fine as a Gaussian is small
  for (const AttributeChannels& a : layout.attributes()) {
    if (a.attribute != Attribute::LogScale) read_attribute(a);
  }
  out.object_id = read_object_ids(source, (flags & kOneObject) != 0);
  if ((flags & kHasIds) != 0) {
    std::uint64_t id = 0;
    const std::vector<std::uint64_t> gaps = read_gaps(source);
    for (std::size_t i = 0; i < count; ++i) out.gaussian_id[i] = id += static_cast<std::uint64_t>(unzigzag(gaps[i]));
  }
  if ((flags & kOwnOrder) != 0) out = scatter(out, read_order(source));
  source.finish();
  return out;
}

}  // namespace splatbus::stream

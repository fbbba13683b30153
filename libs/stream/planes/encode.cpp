#include <algorithm>
#include <cassert>
#include <iterator>
#include <numeric>

#include "stream/page_codec_parts.h"
#include "stream/planes/classes.h"
#include "stream/planes/curve.h"
#include "stream/planes/fit.h"
#include "stream/planes/sink.h"

namespace splatbus::stream {

namespace planes {

namespace {

/// Planes of [count] values, zeros before each.
class PaddedPlanes {
 public:
  /// In `memory`, which keeps its size: what is given back to the system has to be asked for and cleared again.
  PaddedPlanes(std::size_t planes, std::size_t count, std::vector<std::int32_t>& memory)
      : stride_(padded(count) + kStates), values_(memory) {
    if (values_.size() < kStates + planes * stride_) values_.resize(kStates + planes * stride_);
    for (std::size_t plane = 0; plane < planes; ++plane) std::fill_n((*this)[plane] - kStates, kStates, 0);
  }
  [[nodiscard]] std::int32_t* operator[](std::size_t plane) { return values_.data() + kStates + plane * stride_; }
  [[nodiscard]] const std::int32_t* operator[](std::size_t plane) const {
    return values_.data() + kStates + plane * stride_;
  }

 private:
  std::size_t stride_;
  std::vector<std::int32_t>& values_;
};

void put_number(Bytes& out, std::int64_t value) {
  put_varint(out, zigzag(value));
}

void put_model(Bytes& out, const PlaneModel& model) {
  out.push_back(static_cast<std::uint8_t>(static_cast<int>(model.predictor) | static_cast<int>(model.shape) << 3 |
                                          (model.slope - 1) << 4 | (model.per_class != 0 ? 64 : 0)));
  out.push_back(static_cast<std::uint8_t>(model.spread));
  put_number(out, model.offset);
  if (model.per_class != 0) put_number(out, model.per_class);
}

/// Writes planes, one by one.
class Writer {
 public:
  Writer(std::size_t count, bool account)
      : sink(count, account), count_(count), fitter_(count), none_(count), alone_(1, count, alone_memory_) {}
  Sink sink;

  void begin(const Lanes& lanes, PlaneFitter::Effort effort) {
    lanes_ = lanes;
    fitter_.begin(lanes, effort);
  }
  void plane(const Before& before, const std::int32_t* values) {
    const PlaneModel model = fitter_.fit(before, values);
    put_model(sink.header, model);
    if (model.predictor != Predictor::Constant) sink.residuals(model, fitter_.residuals(), lanes_.shift);
  }
  /// A plane by itself, value_of(lane) of each.
  template <class ValueOf>
  void alone(const ValueOf& value_of) {
    for (std::size_t i = 0; i < count_; ++i) alone_[0][i] = value_of(i);
    begin({none_.data(), none_.data()}, PlaneFitter::Effort::OwnOnly);
    plane({}, alone_[0]);
  }
  void gaps(const std::vector<std::uint64_t>& gaps) {
    alone([&](std::size_t i) { return gap_class(gaps[i]).number; });
    for (std::size_t i = 0; i < count_; ++i) {
      const int number = alone_[0][i];
      sink.plain(gaps[i] + 1 - gap_base(number), gap_plain_bits(number));
    }
  }

 private:
  std::size_t count_;
  PlaneFitter fitter_;
  std::vector<std::uint8_t> none_;
  std::vector<std::int32_t> alone_memory_;
  PaddedPlanes alone_;
  Lanes lanes_{};
};

/// How the kept order differs from the curve's: of each lane of the curve, in turn, its place among those that are
/// left.
void put_order(Writer& writer, const std::vector<std::uint32_t>& order) {
  std::vector<std::uint32_t> left(order.size());
  std::iota(left.rbegin(), left.rend(), 0U);  // the first is at the back, where it costs nothing to take it
  std::vector<std::uint64_t> places;
  places.reserve(order.size());
  for (const std::uint32_t lane : order) {
    const auto at = std::find(left.rbegin(), left.rend(), lane);
    places.push_back(static_cast<std::uint64_t>(at - left.rbegin()));
    left.erase(std::next(at).base());
  }
  writer.gaps(places);
}

/// `means`: x, y, z in the order of the curve.
void put_means(Writer& writer, const MortonGrid& grid, const std::int32_t* const means[3],
               const std::vector<std::uint8_t>& shift) {
  Sink& sink = writer.sink;
  for (const std::int32_t origin : grid.origin) put_number(sink.header, origin);
  for (const int bits : grid.bits) sink.header.push_back(static_cast<std::uint8_t>(bits));
  sink.header.push_back(static_cast<std::uint8_t>(grid.low));
  const auto from_origin = [&](std::size_t axis, std::size_t i) {
    return static_cast<std::uint32_t>(means[axis][i] - grid.origin[axis]);
  };
  const Interleaver interleave(grid.bits);
  std::vector<std::uint64_t> gaps(shift.size());
  std::uint64_t before = 0;
  for (std::size_t i = 0; i < gaps.size(); ++i) {
    const std::uint64_t key =
        interleave({from_origin(0, i) >> grid.low, from_origin(1, i) >> grid.low, from_origin(2, i) >> grid.low});
    assert(key >= before);
    gaps[i] = key - before;
    before = key;
  }
  writer.gaps(gaps);
  const std::uint32_t low_mask = (1U << grid.low) - 1;
  for (std::size_t i = 0; i < shift.size(); ++i) {
    const int plain = grid.low - shift[i];
    if (plain <= 0) continue;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      sink.plain((from_origin(axis, i) & low_mask) >> shift[i], plain);
    }
  }
}

void put_object_ids(Bytes& out, const std::vector<std::uint32_t>& ids, bool one) {
  if (one) return put_varint(out, ids[0]);
  for (std::size_t i = 0; i < ids.size();) {
    std::size_t end = i;
    while (end < ids.size() && ids[end] == ids[i]) ++end;
    put_varint(out, end - i - 1);
    put_varint(out, ids[i]);
    i = end;
  }
}

template <class T>
std::vector<T> in_order(const std::vector<T>& values, const std::vector<std::uint32_t>& order) {
  std::vector<T> out(order.size());
  for (std::size_t i = 0; i < order.size(); ++i) out[i] = values[order[i]];
  return out;
}

}  // namespace

}  // namespace planes

PageBlob encode_planes(const QuantizedGaussians& page, const StreamLayout& layout, const PageOptions& options,
                       std::vector<PartBytes>* account) {
  using namespace planes;
  const std::size_t count = page.count();
  const std::vector<std::uint8_t> klass_of_column = classes_of(page, layout);
  Curve curve = sorted_curve(page, layout.at(Attribute::Mean), options.origin);
  PageBlob blob;
  blob.order = std::move(curve.order);
  const std::vector<std::uint32_t>& order = blob.order;
  const bool own_order = options.keep_order && !std::ranges::is_sorted(order);

  const auto channels = static_cast<std::size_t>(layout.channels());
  thread_local std::vector<std::int32_t> memory;
  PaddedPlanes planes(channels, count, memory);
  for (std::size_t c = 0; c < channels; ++c) {
    const std::int32_t* const from = page.channels[c].data();
    std::int32_t* const to = planes[c];
    for (std::size_t i = 0; i < count; ++i) to[i] = from[order[i]];
  }
  const std::vector<std::uint8_t> klass = in_order(klass_of_column, order);

  Writer writer(count, account != nullptr);
  Sink& sink = writer.sink;
  double accounted = 0;
  const auto part_ends = [&](const char* name) {
    if (account == nullptr) return;
    account->push_back({name, sink.size() - accounted});
    accounted = sink.size();
  };
  writer.alone([&](std::size_t i) { return std::int32_t{klass[i]}; });
  part_ends("classes");
  const auto scale = static_cast<std::size_t>(layout.at(Attribute::LogScale).first);
  const std::int32_t* const size[3] = {planes[scale], planes[scale + 1], planes[scale + 2]};
  std::vector<std::uint8_t> shift(count);
  const auto put_attribute = [&](const AttributeChannels& a) {
    const auto first = static_cast<std::size_t>(a.first);
    const ShiftRule rule(layout, a.attribute);
    put_shifts(rule, klass, size, shift.data());
    if (a.attribute == Attribute::Mean) {
      const std::int32_t* const means[3] = {planes[first], planes[first + 1], planes[first + 2]};
      curve.choose_low_bits(shift);
      return put_means(writer, curve.grid, means, shift);
    }
    // Of many coefficients few have neighbours that say much.
    writer.begin({shift.data(), rule.is_constant() ? klass.data() : shift.data()},
                 a.channels > 3 ? PlaneFitter::Effort::Colours : PlaneFitter::Effort::All);
    for (std::size_t c = first; c < first + static_cast<std::size_t>(a.channels); ++c) {
      const std::size_t colour = (c - first) % 3;
      writer.plane(colour == 0 ? Before{} : Before{planes[c - 1], planes[c - colour]}, planes[c]);
    }
  };
  put_attribute(layout.at(Attribute::LogScale));
  part_ends(wire::EnumNameAttribute(Attribute::LogScale));
  for (const AttributeChannels& a : layout.attributes()) {
    if (a.attribute == Attribute::LogScale) continue;
    put_attribute(a);
    part_ends(wire::EnumNameAttribute(a.attribute));
  }
  const std::vector<std::uint32_t> objects = in_order(page.object_id, order);
  const bool one_object = std::ranges::all_of(objects, [&](std::uint32_t id) { return id == objects[0]; });
  put_object_ids(sink.header, objects, one_object);
  part_ends("object ids");
  if (options.ids) {
    std::vector<std::uint64_t> differences;
    differences.reserve(count);
    std::uint64_t before = 0;
    for (const std::uint32_t column : order) {
      const std::uint64_t id = page.gaussian_id[column];
      differences.push_back(zigzag(static_cast<std::int64_t>(id - before)));
      before = id;
    }
    writer.gaps(differences);
    part_ends("ids");
  }
  if (own_order) {
    put_order(writer, order);
    part_ends("order");
    std::iota(blob.order.begin(), blob.order.end(), 0U);
  }
  blob.bytes = sink.finish(static_cast<std::uint8_t>((options.ids ? kHasIds : 0) | (one_object ? kOneObject : 0) |
                                                     (own_order ? kOwnOrder : 0)));
  return blob;
}

}  // namespace splatbus::stream

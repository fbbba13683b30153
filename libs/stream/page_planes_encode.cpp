#include <algorithm>
#include <cassert>
#include <iterator>
#include <numeric>

#include "stream/page_codec_parts.h"
#include "stream/page_curve.h"
#include "stream/page_plane_fit.h"
#include "stream/page_planes_sink.h"

namespace splatbus::stream {

namespace planes {

namespace {

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

void put_plane(Sink& sink, const Lanes& lanes, std::span<const std::vector<std::int32_t>> before,
               const std::vector<std::int32_t>& plane, PlaneFitter& fitter, PlaneFitter::Effort effort) {
  const PlaneModel model = fitter.fit(lanes, before, plane, effort);
  put_model(sink.header, model);
  if (model.predictor != Predictor::Constant) sink.residuals(model, fitter.residuals(), lanes.context, lanes.shift);
}

void put_gaps(Sink& sink, const std::vector<std::uint64_t>& gaps, PlaneFitter& fitter) {
  const std::vector<std::uint8_t> none(gaps.size());
  std::vector<std::int32_t> number;
  number.reserve(gaps.size());
  for (const std::uint64_t gap : gaps) number.push_back(gap_class(gap).number);
  put_plane(sink, {none.data(), {}}, {}, number, fitter, PlaneFitter::Effort::OwnOnly);
  for (std::size_t i = 0; i < gaps.size(); ++i) {
    sink.plain(gaps[i] + 1 - gap_base(number[i]), gap_plain_bits(number[i]));
  }
}

/// How the kept order differs from the curve's: of each lane of the curve, in turn, its place among those that are
/// left.
void put_order(Sink& sink, const std::vector<std::uint32_t>& order, PlaneFitter& fitter) {
  std::vector<std::uint32_t> left(order.size());
  std::iota(left.rbegin(), left.rend(), 0U);  // the first is at the back, where it costs nothing to take it
  std::vector<std::uint64_t> places;
  places.reserve(order.size());
  for (const std::uint32_t lane : order) {
    const auto at = std::find(left.rbegin(), left.rend(), lane);
    places.push_back(static_cast<std::uint64_t>(at - left.rbegin()));
    left.erase(std::next(at).base());
  }
  put_gaps(sink, places, fitter);
}

void put_means(Sink& sink, const MortonGrid& grid, std::span<const std::vector<std::int32_t>> means,
               const std::vector<std::uint8_t>& shift, PlaneFitter& fitter) {
  for (const std::int32_t origin : grid.origin) put_number(sink.header, origin);
  for (const int bits : grid.bits) sink.header.push_back(static_cast<std::uint8_t>(bits));
  sink.header.push_back(static_cast<std::uint8_t>(grid.low));
  const Interleaver interleave(grid.bits);
  const std::size_t count = means[0].size();
  std::vector<std::uint64_t> gaps(count);
  std::uint64_t before = 0;
  const auto from_origin = [&](std::size_t axis, std::size_t i) {
    return static_cast<std::uint32_t>(means[axis][i] - grid.origin[axis]);
  };
  for (std::size_t i = 0; i < count; ++i) {
    const std::uint64_t key =
        interleave({from_origin(0, i) >> grid.low, from_origin(1, i) >> grid.low, from_origin(2, i) >> grid.low});
    assert(key >= before);
    gaps[i] = key - before;
    before = key;
  }
  put_gaps(sink, gaps, fitter);
  for (std::size_t i = 0; i < count; ++i) {
    const int plain = grid.low - shift[i];
    for (std::size_t axis = 0; axis < 3 && plain > 0; ++axis) {
      sink.plain((from_origin(axis, i) & ((1U << grid.low) - 1)) >> shift[i], plain);
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

}  // namespace

}  // namespace planes

PageBlob encode_planes(const QuantizedGaussians& page, const StreamLayout& layout, const PageOptions& options,
                       std::vector<PartBytes>* account) {
  using namespace planes;
  const std::size_t count = page.count();
  const std::vector<std::uint8_t> klass = classes_of(page, layout);
  const Curve curve =
      curve_of(page, layout.at(Attribute::Mean), options.origin, shifts_of(page, layout, Attribute::Mean, klass));
  PageBlob blob;
  blob.order.reserve(count);
  for (const auto& [key, column] : curve.order) blob.order.push_back(column);
  const bool own_order = options.keep_order && !std::ranges::is_sorted(blob.order);
  const QuantizedGaussians lanes = page.gather(blob.order);
  std::vector<std::uint8_t> lane_klass(count);
  for (std::size_t i = 0; i < count; ++i) lane_klass[i] = klass[blob.order[i]];

  Sink sink(count, account != nullptr);
  double accounted = 0;
  const auto part_ends = [&](const char* name) {
    if (account == nullptr) return;
    account->push_back({name, sink.size() - accounted});
    accounted = sink.size();
  };
  PlaneFitter fitter(count);
  {
    const std::vector<std::uint8_t> none(count);
    const std::vector<std::int32_t> plane(lane_klass.begin(), lane_klass.end());
    put_plane(sink, {none.data(), {}}, {}, plane, fitter, PlaneFitter::Effort::OwnOnly);
  }
  part_ends("classes");
  const auto put_attribute = [&](const AttributeChannels& a) {
    const auto all =
        std::span(lanes.channels).subspan(static_cast<std::size_t>(a.first), static_cast<std::size_t>(a.channels));
    const ShiftRule rule(layout, a.attribute);
    const std::vector<std::uint8_t> shift = shifts_of(lanes, layout, a.attribute, lane_klass);
    if (a.attribute == Attribute::Mean) return put_means(sink, curve.grid, all, shift, fitter);
    Lanes contexts{rule.is_constant() ? lane_klass.data() : shift.data(), {}};
    for (int k = 0; k < kClasses; ++k) {
      contexts.shift[static_cast<std::size_t>(k)] = static_cast<std::uint8_t>(
          rule.is_constant() ? shift_at(k - kClassBias, rule.offset(0, 0, 0), rule.cap()) : std::min(k, rule.cap()));
    }
    // Of many coefficients few have neighbours that say much.
    const auto effort = a.channels > 3 ? PlaneFitter::Effort::Colours : PlaneFitter::Effort::All;
    for (std::size_t c = 0; c < all.size(); ++c) put_plane(sink, contexts, all.first(c), all[c], fitter, effort);
  };
  put_attribute(layout.at(Attribute::LogScale));
  part_ends(wire::EnumNameAttribute(Attribute::LogScale));
  for (const AttributeChannels& a : layout.attributes()) {
    if (a.attribute == Attribute::LogScale) continue;
    put_attribute(a);
    part_ends(wire::EnumNameAttribute(a.attribute));
  }
  const bool one_object =
      std::ranges::all_of(lanes.object_id, [&](std::uint32_t id) { return id == lanes.object_id[0]; });
  put_object_ids(sink.header, lanes.object_id, one_object);
  part_ends("object ids");
  if (options.ids) {
    std::vector<std::uint64_t> differences;
    std::uint64_t before = 0;
    for (const std::uint64_t id : lanes.gaussian_id) {
      differences.push_back(zigzag(static_cast<std::int64_t>(id - before)));
      before = id;
    }
    put_gaps(sink, differences, fitter);
    part_ends("ids");
  }
  if (own_order) {
    put_order(sink, blob.order, fitter);
    part_ends("order");
    std::iota(blob.order.begin(), blob.order.end(), 0U);
  }
  blob.bytes = sink.finish(static_cast<std::uint8_t>((options.ids ? kHasIds : 0) | (one_object ? kOneObject : 0) |
                                                     (own_order ? kOwnOrder : 0)));
  return blob;
}

}  // namespace splatbus::stream

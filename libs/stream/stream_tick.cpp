#include <algorithm>
#include <cassert>
#include <cmath>
#include <numeric>

#include "stream/codecs.h"
#include "stream/delta_selection.h"
#include "stream/stream_model.h"

namespace splatbus::stream {

namespace {

constexpr std::size_t kMinChunk = 256;  // below that Draco's tables cost more than the Gaussians
constexpr double kAppendShare = 0.8;    // of the budget, while deltas wait

template <class Body>
auto packet_with_slots(std::size_t first, std::size_t count, std::uint32_t raw_bytes, Body&& create) {
  return [=](flatbuffers::FlatBufferBuilder& builder) {
    return create(builder, static_cast<std::uint32_t>(first), static_cast<std::uint32_t>(count), raw_bytes);
  };
}

}  // namespace

// The mirror takes the packet as a viewer does, from its bytes.
template <class Build>
void StreamModel::emit(std::vector<EncodedPacket>& out, wire::Body body, Build&& build, Payload payload) {
  const std::uint64_t sequence = held_.sequence + 1;
  out.push_back(writer_.write(held_.epoch, sequence, body, build, std::move(payload.bytes)));
  take_packet(out.back());
}

void StreamModel::take_packet(const EncodedPacket& packet) {
  apply(held_, ParsedPacket::parse(packet.packet, packet.payload), options_.max_gaussians);
  held_.sequence = packet.sequence;
}

std::vector<EncodedPacket> StreamModel::tick(double budget_bytes, std::span<const Camera> viewers) {
  assert(ready_);
  ready_ = false;  // an exception loses the packets that the mirror has taken
  std::vector<EncodedPacket> out;
  tick_removals(out);
  tick_objects(out);
  double left = budget_bytes;
  for (const EncodedPacket& packet : out) left -= static_cast<double>(packet.bytes());
  const std::size_t before = out.size();
  tick_appends(out, selection_.pending() > 0 ? kAppendShare * left : left, viewers);
  for (std::size_t i = before; i < out.size(); ++i) left -= static_cast<double>(out[i].bytes());
  tick_deltas(out, left, viewers);
  ready_ = true;
  return out;
}

void StreamModel::tick_removals(std::vector<EncodedPacket>& out) {
  if (gone_.empty()) return;
  Payload payload = encode_slots(gone_);
  const std::uint32_t raw_bytes = payload.raw_bytes;
  emit(
      out, wire::Body::Remove,
      [&](auto& builder) { return wire::CreateRemove(builder, static_cast<std::uint32_t>(gone_.size()), raw_bytes); },
      std::move(payload));
  selection_.remove(gone_);
  index_ids();
  map_columns();
}

void StreamModel::tick_objects(std::vector<EncodedPacket>& out) {
  const std::vector<std::uint32_t>& held = held_.gaussians.object_id;
  std::size_t first = held.size(), last = 0;
  for (std::size_t slot = 0; slot < held.size(); ++slot) {
    if (column_of_slot_[slot] == kNotHeld || target_.object_id[column_of_slot_[slot]] == held[slot]) continue;
    first = std::min(first, slot);
    last = slot;
  }
  if (first == held.size()) return;
  std::vector<std::uint32_t> ids;
  for (std::size_t slot = first; slot <= last; ++slot) {
    ids.push_back(column_of_slot_[slot] == kNotHeld ? held[slot] : target_.object_id[column_of_slot_[slot]]);
  }
  Payload payload = encode_runs(ids);
  const auto build = packet_with_slots(first, ids.size(), payload.raw_bytes, wire::CreateObjectIds);
  emit(out, wire::Body::ObjectIds, build, std::move(payload));
}

void StreamModel::append_chunk(std::vector<EncodedPacket>& out, std::span<const std::uint32_t> columns) {
  const QuantizedGaussians chunk = target_.gather(columns);
  const std::size_t first = held_.gaussians.count();
  const std::size_t before = out.size();
  emit(out, wire::Body::Snapshot,
       packet_with_slots(
           first, columns.size(), 0,
           [](auto& builder, auto slot, auto count, auto) { return wire::CreateSnapshot(builder, 0, 0, slot, count); }),
       {encode_chunk(chunk, held_.layout), 0});
  Payload ids = encode_ids(chunk.gaussian_id);
  const auto build_ids = packet_with_slots(first, columns.size(), ids.raw_bytes, wire::CreateGaussianOrder);
  emit(out, wire::Body::GaussianOrder, build_ids, std::move(ids));
  const auto bytes = static_cast<double>(out[before].bytes() + out[before + 1].bytes());
  chunk_bytes_per_gaussian_ += 0.5 * (bytes / static_cast<double>(columns.size()) - chunk_bytes_per_gaussian_);
  selection_.append(chunk);
  for (std::size_t i = 0; i < columns.size(); ++i) {
    const auto slot = static_cast<std::uint32_t>(first + i);
    slot_of_id_.emplace(chunk.gaussian_id[i], slot);
    slot_of_column_[columns[i]] = slot;
    column_of_slot_.push_back(columns[i]);
  }
}

void StreamModel::tick_appends(std::vector<EncodedPacket>& out, double budget_bytes, std::span<const Camera> viewers) {
  std::size_t room_left = room();
  if (fresh_.empty() || budget_bytes <= 0 || room_left == 0) return;
  const double affordable = std::max(budget_bytes / chunk_bytes_per_gaussian_, static_cast<double>(kMinChunk));
  const auto order = morton_order(target_, held_.layout, fresh_);
  const std::size_t size = std::min(options_.chunk_gaussians, static_cast<std::size_t>(affordable));
  std::vector<std::pair<double, std::size_t>> chunks;  // mean share, first in `order`
  const auto share = picture_share(target_.gather(order), held_.layout, viewers, held_.scene.objects);
  for (std::size_t first = 0; first < order.size(); first += size) {
    double sum = 0;
    const std::size_t end = std::min(first + size, order.size());
    for (std::size_t i = first; i < end; ++i) sum += share[i];
    chunks.emplace_back(sum / static_cast<double>(end - first), first);
  }
  std::ranges::sort(chunks, std::greater<>{});
  std::vector<std::uint8_t> sent(target_.count());
  double left = budget_bytes;
  for (const auto& [mean_share, first] : chunks) {
    const std::size_t count = std::min({size, order.size() - first, room_left});
    const double cost = static_cast<double>(count) * chunk_bytes_per_gaussian_;
    if (count == 0 || (left < budget_bytes && cost > left)) break;  // at least one
    append_chunk(out, std::span(order).subspan(first, count));
    for (std::size_t i = first; i < first + count; ++i) sent[order[i]] = 1;
    left -= cost;
    room_left -= count;
  }
  std::erase_if(fresh_, [&](std::uint32_t column) { return sent[column] != 0; });
}

void StreamModel::tick_deltas(std::vector<EncodedPacket>& out, double budget_bytes, std::span<const Camera> viewers) {
  if (budget_bytes <= 0) return;
  const auto share = picture_share(held_.gaussians, held_.layout, viewers, held_.scene.objects);
  for (const SelectedDelta& selected :
       selection_.select(held_.gaussians, target_, column_of_slot_, share, budget_bytes)) {
    Payload payload = encode_delta(selected.delta);
    const auto count = static_cast<std::uint32_t>(selected.delta.slots.size());
    const auto channels = static_cast<std::uint32_t>(selected.delta.residuals.size());
    const auto build = [&, raw_bytes = payload.raw_bytes](auto& builder) {
      return wire::CreateTensorDelta(builder, selected.attribute, count, channels, raw_bytes);
    };
    emit(out, wire::Body::TensorDelta, build, std::move(payload));
    selection_.learn_cost(selected.attribute, count, out.back().bytes());
  }
}

EncodedSnapshot StreamModel::snapshot() {
  assert(ready_);
  EncodedSnapshot snapshot;
  snapshot.as_of = held_.sequence;
  const std::uint64_t id = ++snapshots_;
  snapshot.tail = light_rows();
  const auto rows = static_cast<std::uint32_t>(snapshot.tail.size());
  const std::size_t total = held_.gaussians.count(), size = options_.chunk_gaussians;
  const auto unicast = [&](wire::Body body, auto&& build, Bytes payload = {}) {
    return writer_.write(held_.epoch, 0, body, build, std::move(payload));
  };
  snapshot.head.push_back(unicast(wire::Body::SnapshotBegin, [&](auto& builder) {
    std::vector<flatbuffers::Offset<wire::TensorMetadata>> attributes;
    for (const AttributeChannels& a : held_.layout.attributes()) {
      const wire::Quantizer quantizer(a.quantizer.offset, a.quantizer.step);
      attributes.push_back(
          wire::CreateTensorMetadata(builder, a.attribute, static_cast<std::uint32_t>(a.channels), &quantizer));
    }
    const ParameterLayout& parameters = held_.layout.parameters();
    const bool transfer = parameters.appearance == Appearance::Transfer;
    return wire::CreateSnapshotBegin(builder, id, snapshot.as_of, static_cast<std::uint32_t>(total),
                                     static_cast<std::uint32_t>((total + size - 1) / size),
                                     transfer ? wire::Appearance::Transfer : wire::Appearance::Radiance,
                                     static_cast<std::uint8_t>(transfer ? 0 : parameters.sh_degree),
                                     builder.CreateVector(attributes), held_.visibility_version, rows);
  }));
  snapshot.head.push_back(scene_packet(0, nullptr));
  for (std::size_t first = 0; first < total; first += size) {
    std::vector<std::uint32_t> slots(std::min(size, total - first));
    std::iota(slots.begin(), slots.end(), static_cast<std::uint32_t>(first));
    const QuantizedGaussians chunk = held_.gaussians.gather(slots);
    snapshot.chunks.push_back(unicast(
        wire::Body::Snapshot,
        [&](auto& builder) {
          return wire::CreateSnapshot(builder, id, static_cast<std::uint32_t>(first / size), slots.front(),
                                      static_cast<std::uint32_t>(slots.size()));
        },
        encode_chunk(chunk, held_.layout)));
    Payload ids = encode_ids(chunk.gaussian_id);
    snapshot.tail.push_back(unicast(wire::Body::GaussianOrder,
                                    packet_with_slots(first, slots.size(), ids.raw_bytes, wire::CreateGaussianOrder),
                                    std::move(ids.bytes)));
  }
  return snapshot;
}

}  // namespace splatbus::stream

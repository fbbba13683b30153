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
void StreamModel::emit(wire::Body body, Build&& build, Payload payload) {
  const std::scoped_lock lock(mutex_);
  take_packet(writer_.write(held_.epoch, held_.sequence + 1, body, build, std::move(payload.bytes)));
  tick_bytes_ += static_cast<double>(made_.back().bytes());
}

void StreamModel::take_packet(EncodedPacket packet) {
  apply(held_, ParsedPacket::parse(packet.packet, packet.payload), options_.max_gaussians);
  held_.sequence = packet.sequence;
  made_.push_back(std::move(packet));
}

std::vector<EncodedPacket> StreamModel::take_packets() {
  const std::scoped_lock lock(mutex_);
  return std::exchange(made_, {});
}

StreamModel::Status StreamModel::status() const {
  const std::scoped_lock lock(mutex_);
  return {.ready = ready_,
          .epoch = held_.epoch,
          .sequence = held_.sequence,
          .visibility_version = held_.visibility_version,
          .gaussians = held_.gaussians.count(),
          .layout = held_.layout.parameters()};
}

std::vector<EncodedPacket> StreamModel::tick(double budget_bytes, std::span<const Camera> viewers) {
  make_tick(budget_bytes, viewers);
  return take_packets();
}

double StreamModel::make_tick(double budget_bytes, std::span<const Camera> viewers) {
  assert(ready_);
  ObjectTransforms objects;
  {
    const std::scoped_lock lock(mutex_);
    objects = held_.scene.objects;
  }
  tick_bytes_ = 0;
  try {
    tick_removals();
    tick_objects();
    const double left = budget_bytes - tick_bytes_;
    tick_appends(selection_.pending() > 0 ? kAppendShare * left : left, viewers, objects);
    tick_deltas(budget_bytes - tick_bytes_, viewers, objects);
  } catch (...) {
    set_ready(false);  // what is kept of the mirror's columns may lag behind it
    throw;
  }
  return tick_bytes_;
}

void StreamModel::tick_removals() {
  if (gone_.empty()) return;
  Payload payload = encode_slots(gone_);
  const std::uint32_t raw_bytes = payload.raw_bytes;
  emit(
      wire::Body::Remove,
      [&](auto& builder) { return wire::CreateRemove(builder, static_cast<std::uint32_t>(gone_.size()), raw_bytes); },
      std::move(payload));
  selection_.remove(gone_);
  index_ids();
  map_columns();
}

void StreamModel::tick_objects() {
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
  emit(wire::Body::ObjectIds, build, std::move(payload));
}

void StreamModel::append_chunk(std::span<const std::uint32_t> columns) {
  const QuantizedGaussians chunk = target_.gather(columns);
  const std::size_t first = held_.gaussians.count();
  const double before = tick_bytes_;
  emit(wire::Body::Snapshot,
       packet_with_slots(
           first, columns.size(), 0,
           [](auto& builder, auto slot, auto count, auto) { return wire::CreateSnapshot(builder, 0, 0, slot, count); }),
       {encode_chunk(chunk, held_.layout), 0});
  Payload ids = encode_ids(chunk.gaussian_id);
  const auto build_ids = packet_with_slots(first, columns.size(), ids.raw_bytes, wire::CreateGaussianOrder);
  emit(wire::Body::GaussianOrder, build_ids, std::move(ids));
  chunk_bytes_per_gaussian_ +=
      0.5 * ((tick_bytes_ - before) / static_cast<double>(columns.size()) - chunk_bytes_per_gaussian_);
  selection_.append(chunk);
  for (std::size_t i = 0; i < columns.size(); ++i) {
    const auto slot = static_cast<std::uint32_t>(first + i);
    slot_of_id_.emplace(chunk.gaussian_id[i], slot);
    slot_of_column_[columns[i]] = slot;
    column_of_slot_.push_back(columns[i]);
  }
}

void StreamModel::tick_appends(double budget_bytes, std::span<const Camera> viewers, const ObjectTransforms& objects) {
  std::size_t room_left = room();
  if (fresh_.empty() || budget_bytes <= 0 || room_left == 0) return;
  const double affordable = std::max(budget_bytes / chunk_bytes_per_gaussian_, static_cast<double>(kMinChunk));
  const auto order = morton_order(target_, held_.layout, fresh_);
  const std::size_t size = std::min(options_.chunk_gaussians, static_cast<std::size_t>(affordable));
  std::vector<std::pair<double, std::size_t>> chunks;  // mean share, first in `order`
  const auto share = picture_share(target_.gather(order), held_.layout, viewers, objects);
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
    append_chunk(std::span(order).subspan(first, count));
    for (std::size_t i = first; i < first + count; ++i) sent[order[i]] = 1;
    left -= cost;
    room_left -= count;
  }
  std::erase_if(fresh_, [&](std::uint32_t column) { return sent[column] != 0; });
}

void StreamModel::tick_deltas(double budget_bytes, std::span<const Camera> viewers, const ObjectTransforms& objects) {
  if (budget_bytes <= 0) return;
  const auto share = picture_share(held_.gaussians, held_.layout, viewers, objects);
  for (const SelectedDelta& selected :
       selection_.select(held_.gaussians, target_, column_of_slot_, share, budget_bytes)) {
    Payload payload = encode_delta(selected.delta);
    const auto count = static_cast<std::uint32_t>(selected.delta.slots.size());
    const auto channels = static_cast<std::uint32_t>(selected.delta.residuals.size());
    const auto build = [&, raw_bytes = payload.raw_bytes](auto& builder) {
      return wire::CreateTensorDelta(builder, selected.attribute, count, channels, raw_bytes);
    };
    const double before = tick_bytes_;
    emit(wire::Body::TensorDelta, build, std::move(payload));
    selection_.learn_cost(selected.attribute, count, static_cast<std::size_t>(tick_bytes_ - before));
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

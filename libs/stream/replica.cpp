#include "stream/replica.h"

#include <fmt/format.h>

#include <algorithm>
#include <cassert>
#include <numeric>
#include <utility>

#include "stream/bytes.h"
#include "stream/codecs.h"

namespace splatbus::stream {

namespace {

constexpr std::size_t kMaxEarlyBytes = std::size_t{1} << 25;
constexpr std::size_t kMaxEarlyPackets = 4096;
constexpr std::size_t kMinChanges = std::size_t{1} << 20;  // bytes; below that a whole is not worth its while

const ReplicatedState& nothing() {
  static const ReplicatedState state;
  return state;
}

bool is_numbered_content(wire::Body body) {
  switch (body) {
    case wire::Body::Snapshot:
    case wire::Body::TensorDelta:
    case wire::Body::Remove:
    case wire::Body::GaussianOrder:
    case wire::Body::ObjectIds:
    case wire::Body::Scene:
    case wire::Body::LightVisibility:
      return true;
    default:
      return false;
  }
}

std::vector<std::uint32_t> all_slots(const ReplicatedState& state) {
  std::vector<std::uint32_t> slots(state.gaussians.count());
  std::iota(slots.begin(), slots.end(), 0U);
  return slots;
}

DisplaySeen seen_of_sun(const ReplicatedState& state) {
  DisplaySeen seen{.light_id = 0, .columns = {}, .values = {}};
  if (const AttributeChannels* a = state.layout.find(Attribute::Visibility)) {
    const std::vector<std::int32_t>& plane = state.gaussians.channels[a->first];
    seen.columns = all_slots(state);
    seen.values.assign(plane.begin(), plane.end());
  }
  return seen;
}

}  // namespace

bool Replica::receive(const ParsedPacket& packet) {
  if (packet.body() == wire::Body::SnapshotBegin) {
    begin(*packet.root().body_as_SnapshotBegin(), packet.stream_epoch());
    return false;
  }
  if (packet.stream_epoch() != epoch() || epoch() == 0) return false;
  if (packet.body() == wire::Body::Keepalive) {
    last_known_ = std::max(last_known_, packet.root().body_as_Keepalive()->last_sequence());
    return false;
  }
  if (!is_numbered_content(packet.body())) return false;
  if (packet.sequence() == 0) return load(packet);
  if (needs_snapshot() || packet.sequence() <= base()) return false;
  last_known_ = std::max(last_known_, packet.sequence());
  if (loading() || packet.sequence() != base() + 1) {
    keep(packet);
    return false;
  }
  const bool changed = apply_in_order(packet);
  return drain() || changed;
}

void Replica::begin(const wire::SnapshotBegin& body, std::uint64_t epoch) {
  if (epoch == 0) throw StreamError("SnapshotBegin: no stream epoch");
  if (body.total() > max_gaussians_ || body.chunk_count() > body.total() ||
      (body.total() > 0 && body.chunk_count() == 0)) {
    refuse_snapshot(fmt::format("SnapshotBegin: {} Gaussians in {} chunks, at most {} Gaussians are accepted",
                                body.total(), body.chunk_count(), max_gaussians_));
  }
  const StreamLayout layout = layout_of(body);
  Loading loading;
  loading.snapshot = body.snapshot();
  loading.total = body.total();
  loading.chunk_count = body.chunk_count();
  loading.light_rows = body.light_rows();
  ReplicatedState& state = loading.state;
  state.layout = layout;
  state.gaussians = QuantizedGaussians(state.layout);
  state.epoch = epoch;
  state.sequence = body.as_of();
  state.visibility_version = body.visibility_version();
  if (const ReplicatedState* before = shown()) {  // until the snapshot's own arrives
    state.light_rows.set_lights(before->light_rows.ids(), 0);
    state.quantized_scene = before->quantized_scene;
    state.scene = before->scene;
    state.instant = before->instant;
  }
  if (epoch != this->epoch()) {
    last_known_ = 0;
    early_.clear();
    early_bytes_ = 0;
  }
  last_known_ = std::max(last_known_, body.as_of());
  loading_ = std::move(loading);
  refusal_.clear();
  if (shown() == &loading_->state) show_whole();
  if (loading_->total == 0) finish_loading();
}

bool Replica::load(const ParsedPacket& packet) {
  switch (packet.body()) {
    case wire::Body::Snapshot:
      return load_chunk(packet);
    case wire::Body::GaussianOrder:
      return load_ids(packet);
    case wire::Body::LightVisibility:
      return load_light_row(packet);
    case wire::Body::Scene:
      if (loading_) return apply_to(loading_->state, packet) && shown() == &loading_->state;
      return held_ && apply_to(*held_, packet);
    default:
      throw StreamError(fmt::format("{}: is no part of a snapshot", wire::EnumNameBody(packet.body())));
  }
}

bool Replica::load_chunk(const ParsedPacket& packet) {
  const wire::Snapshot& body = *packet.root().body_as_Snapshot();
  if (!loading_ || body.snapshot() != loading_->snapshot || loading_->chunks.contains(body.first_slot())) return false;
  if (body.first_slot() > loading_->total || body.count() > loading_->total - body.first_slot()) {
    throw StreamError(fmt::format("Snapshot: slots {} to {} of {}", body.first_slot(),
                                  std::uint64_t{body.first_slot()} + body.count(), loading_->total));
  }
  ReplicatedState& part = loading_->state;
  const std::size_t column = part.gaussians.count();
  if (column + body.count() > loading_->total) refuse_snapshot("Snapshot: chunks overlap");
  QuantizedGaussians chunk = decode_chunk(packet.payload(), part.layout, body.count());
  part.gaussians.append(chunk);
  part.light_rows.append(chunk.count());
  if (shown() == &part) {
    if (observer_) {
      Change appended{.kind = Change::Kind::Appended, .slots = std::vector<std::uint32_t>(chunk.count())};
      std::iota(appended.slots.begin(), appended.slots.end(), static_cast<std::uint32_t>(column));
      note(part, appended);
    } else {
      note(DisplayAppend{std::move(chunk)});
    }
  }
  loading_->chunks.emplace(body.first_slot(), Chunk{column, body.count()});
  const bool visible = shown() == &part;
  if (part.gaussians.count() < loading_->total) return visible;
  finish_loading();
  return true;
}

// What was broadcast since waits for the last of them: a Remove before would move the slots that they name.
bool Replica::load_ids(const ParsedPacket& packet) {
  if (loading_ || missing_ids_ == 0) return false;
  const wire::GaussianOrder& body = *packet.root().body_as_GaussianOrder();
  const std::size_t next = held_->gaussians.count() - missing_ids_;
  if (body.first_slot() != next) {
    throw StreamError(fmt::format("GaussianOrder: ids from slot {} on where {} is next", body.first_slot(), next));
  }
  const bool changed = apply_to(*held_, packet);
  missing_ids_ -= body.count();
  return drain() || changed;
}

bool Replica::load_light_row(const ParsedPacket& packet) {
  if (loading_ || missing_rows_ == 0) return false;
  const bool changed = apply_to(*held_, packet);
  --missing_rows_;
  return drain() || changed;
}

void Replica::refuse_snapshot(const std::string& why) {
  const bool was_shown = loading_ && shown() == &loading_->state;
  loading_.reset();
  if (was_shown) show_whole();
  refusal_ = why;
  throw StreamError(why);
}

StreamLayout Replica::layout_of(const wire::SnapshotBegin& body) {
  try {
    return StreamLayout::from_wire(body);
  } catch (const StreamError& error) {
    refuse_snapshot(error.what());
  }
}

void Replica::finish_loading() {
  Loading& loading = *loading_;
  std::vector<std::uint32_t> order;
  order.reserve(loading.total);
  for (const auto& [first, chunk] : loading.chunks) {
    if (first != order.size()) refuse_snapshot("Snapshot: chunks overlap");
    for (std::size_t i = 0; i < chunk.count; ++i) order.push_back(static_cast<std::uint32_t>(chunk.column + i));
  }
  assert(order.size() == loading.total);  // the counts add up to it
  const bool was_shown = shown() == &loading.state;
  held_ = std::make_unique<ReplicatedState>(std::move(loading.state));
  held_->gaussians = held_->gaussians.gather(order);
  missing_ids_ = loading.total;
  missing_rows_ = loading.light_rows;
  loading_.reset();
  if (!was_shown) {
    show_whole();
  } else if (observer_) {
    observer_->on_order(order);
  } else {
    note(DisplayOrder{std::move(order)});
  }
}

bool Replica::apply_to(ReplicatedState& state, const ParsedPacket& packet) {
  const Change change = apply(state, packet, max_gaussians_);
  if (shown() == &state) note(state, change);
  return change.kind != Change::Kind::Nothing;
}

void Replica::note(const ReplicatedState& state, const Change& change) {
  if (observer_) {
    if (change.kind != Change::Kind::Nothing) observer_->on_change(state, change);
    return;
  }
  switch (change.kind) {
    case Change::Kind::Appended:
      note(DisplayAppend{state.gaussians.gather(change.slots)});
      break;
    case Change::Kind::Values: {
      const AttributeChannels& a = state.layout.at(change.attribute);
      DisplayValues values{.attribute = change.attribute, .columns = change.slots, .values = {}};
      values.values.reserve(static_cast<std::size_t>(a.channels) * change.slots.size());
      for (int c = a.first; c < a.first + a.channels; ++c) {
        for (const std::uint32_t slot : change.slots) values.values.push_back(state.gaussians.channels[c][slot]);
      }
      if (change.attribute == Attribute::Visibility && !state.light_rows.all().empty()) {
        note(DisplaySeen{0, change.slots, Bytes(values.values.begin(), values.values.end())});
      }
      note(std::move(values));
      break;
    }
    case Change::Kind::Seen: {
      DisplaySeen seen{.light_id = change.light_id, .columns = change.slots, .values = {}};
      const Bytes& row = *state.light_rows.find(change.light_id);
      for (const std::uint32_t slot : change.slots) seen.values.push_back(row[slot]);
      note(std::move(seen));
      break;
    }
    case Change::Kind::Removed:
      note(DisplayRemoval{change.slots});
      break;
    case Change::Kind::Objects: {
      DisplayObjects objects{.columns = change.slots, .object_ids = {}};
      for (const std::uint32_t slot : change.slots) objects.object_ids.push_back(state.gaussians.object_id[slot]);
      note(std::move(objects));
      break;
    }
    case Change::Kind::Scene:
      if (change.lights_changed) {
        note(DisplayLights{state.light_rows.ids()});
        if (!state.light_rows.all().empty()) note(seen_of_sun(state));
      }
      break;
    case Change::Kind::Nothing:
      break;
  }
}

void Replica::show_whole() {
  if (observer_) {
    observer_->on_reset(shown_state());
  } else {
    changes_ = whole();
  }
}

void Replica::observe_with(ShownObserver& observer) {
  observer_ = &observer;
  changes_.clear();
  show_whole();
}

void Replica::note(DisplayChange change) {
  changes_.add(std::move(change));
  if (exceeds_whole(changes_)) show_whole();
}

bool Replica::exceeds_whole(const DisplayChanges& changes) const {
  const ReplicatedState& state = shown_state();
  const std::size_t rows = 5 * state.light_rows.all().size() * state.gaussians.count();
  return changes.bytes() > kMinChanges + 2 * (display_bytes(state.gaussians) + rows);
}

DisplayChanges Replica::take_changes() {
  return std::exchange(changes_, {});
}

DisplayChanges Replica::whole() const {
  const ReplicatedState& state = shown_state();
  DisplayChanges out;
  out.add(DisplayReset{state.layout});
  if (!state.light_rows.all().empty()) out.add(DisplayLights{state.light_rows.ids()});
  if (state.gaussians.count() == 0) return out;
  out.add(DisplayAppend{state.gaussians});
  for (const auto& [id, row] : state.light_rows.all()) out.add(DisplaySeen{id, all_slots(state), row});
  return out;
}

bool Replica::apply_in_order(const ParsedPacket& packet) {
  try {
    const bool changed = apply_to(*held_, packet);
    held_->sequence = packet.sequence();
    return changed;
  } catch (const StreamError& error) {
    refusal_ = error.what();
    throw;
  }
}

bool Replica::drain() {
  bool changed = false;
  while (!loading() && !needs_snapshot() && !early_.empty() && early_.begin()->first <= base() + 1) {
    const auto node = early_.extract(early_.begin());
    early_bytes_ -= std::min(early_bytes_, node.mapped().bytes());
    // What the snapshot already has is dropped.
    if (node.key() == base() + 1) changed = apply_in_order(node.mapped()) || changed;
  }
  return changed;
}

void Replica::keep(const ParsedPacket& packet) {
  if (early_.size() >= kMaxEarlyPackets || early_bytes_ + packet.bytes() > kMaxEarlyBytes) return;
  if (early_.emplace(packet.sequence(), packet).second) early_bytes_ += packet.bytes();
}

const ReplicatedState* Replica::shown() const {
  if (held_ && (held_->gaussians.count() > 0 || !loading_)) return held_.get();
  return loading_ ? &loading_->state : nullptr;
}

std::uint64_t Replica::base() const {
  if (loading_) return loading_->state.sequence;
  return held_ ? held_->sequence : 0;
}

const ReplicatedState& Replica::shown_state() const {
  const ReplicatedState* s = shown();
  return s ? *s : nothing();
}

std::uint64_t Replica::epoch() const {
  if (loading_) return loading_->state.epoch;
  return held_ ? held_->epoch : 0;
}

std::uint32_t Replica::missing_chunks() const {
  return loading_ ? static_cast<std::uint32_t>(loading_->chunk_count -
                                               std::min(loading_->chunk_count, loading_->chunks.size()))
                  : 0;
}

std::optional<MissingPackets> Replica::missing() const {
  if (loading() || needs_snapshot() || !held_) return std::nullopt;
  const std::uint64_t next = base() + 1;
  if (!early_.empty()) return MissingPackets{next, early_.begin()->first - 1};
  if (last_known_ >= next) return MissingPackets{next, last_known_};
  return std::nullopt;
}

}  // namespace splatbus::stream

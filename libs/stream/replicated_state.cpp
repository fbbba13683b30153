#include "stream/replicated_state.h"

#include <fmt/format.h>

#include <algorithm>
#include <numeric>
#include <utility>

#include "stream/bytes.h"
#include "stream/codecs.h"
#include "stream/scene_codec.h"

namespace splatbus::stream {

namespace {

void require_range(std::string_view what, std::size_t first, std::size_t count, std::size_t held) {
  if (first > held || count > held - first) {
    throw StreamError(fmt::format("{}: slots {} to {} of {} held", what, first, first + count, held));
  }
}

std::vector<std::uint32_t> slot_range(std::size_t first, std::size_t count) {
  std::vector<std::uint32_t> slots(count);
  std::iota(slots.begin(), slots.end(), static_cast<std::uint32_t>(first));
  return slots;
}

Change append(ReplicatedState& state, const wire::Snapshot& body, std::span<const std::uint8_t> payload,
              std::size_t max_gaussians) {
  const std::size_t held = state.gaussians.count();
  if (body.first_slot() != held) {
    throw StreamError(fmt::format("Snapshot: appends at slot {} where {} are held", body.first_slot(), held));
  }
  if (body.count() > max_gaussians || held > max_gaussians - body.count()) {
    throw StreamError(
        fmt::format("Snapshot: {} more Gaussians than {} exceed the limit of {}", body.count(), held, max_gaussians));
  }
  state.gaussians.append(decode_chunk(payload, state.layout, body.count()));
  state.light_rows.append(body.count());
  return {.kind = Change::Kind::Appended, .slots = slot_range(held, body.count())};
}

Change add_residuals(ReplicatedState& state, const wire::TensorDelta& body, std::span<const std::uint8_t> payload) {
  const AttributeChannels* a = state.layout.find(body.attribute());
  if (!a) {
    throw StreamError(
        fmt::format("TensorDelta: attribute {} is not in this stream", static_cast<int>(body.attribute())));
  }
  if (body.channels() != static_cast<std::uint32_t>(a->channels)) {
    throw StreamError(fmt::format("TensorDelta: {} channels of {} where it has {}", body.channels(),
                                  wire::EnumNameAttribute(a->attribute), a->channels));
  }
  Delta delta = decode_delta(payload, body.raw_bytes(), body.count(), body.channels(), state.gaussians.count());
  for (int c = 0; c < a->channels; ++c) {
    const auto& plane = state.gaussians.channels[a->first + c];
    for (std::size_t i = 0; i < delta.slots.size(); ++i) {
      const std::int64_t sum = std::int64_t{plane[delta.slots[i]]} + delta.residuals[c][i];
      if (sum < a->minimum || sum > a->maximum) {
        throw StreamError(fmt::format("TensorDelta: {} of slot {} would be {}", wire::EnumNameAttribute(a->attribute),
                                      delta.slots[i], sum));
      }
      delta.residuals[c][i] = static_cast<std::int32_t>(sum);
    }
  }
  for (int c = 0; c < a->channels; ++c) {
    auto& plane = state.gaussians.channels[a->first + c];
    for (std::size_t i = 0; i < delta.slots.size(); ++i) plane[delta.slots[i]] = delta.residuals[c][i];
  }
  return {.kind = Change::Kind::Values, .attribute = a->attribute, .slots = std::move(delta.slots)};
}

Change take_visibility(ReplicatedState& state, const wire::LightVisibility& body,
                       std::span<const std::uint8_t> payload) {
  const AttributeChannels* a = state.layout.find(Attribute::Visibility);
  if (!a) throw StreamError("LightVisibility: this stream has no visibility");
  if (body.scene_version() < state.visibility_version) {
    throw StreamError(fmt::format("LightVisibility: of scene version {} where {} is held", body.scene_version(),
                                  state.visibility_version));
  }
  Bytes* row = body.light_id() != 0 ? state.light_rows.find(body.light_id()) : nullptr;
  if (body.light_id() != 0 && !row) {
    throw StreamError(fmt::format("LightVisibility: of light {}, which the scene does not have", body.light_id()));
  }
  SlotValues change = decode_slot_values(payload, body.raw_bytes(), body.count(), state.gaussians.count());
  state.visibility_version = body.scene_version();
  if (row) {
    for (std::size_t i = 0; i < change.slots.size(); ++i) (*row)[change.slots[i]] = change.values[i];
    return {.kind = Change::Kind::Seen, .slots = std::move(change.slots), .light_id = body.light_id()};
  }
  auto& plane = state.gaussians.channels[a->first];
  for (std::size_t i = 0; i < change.slots.size(); ++i) plane[change.slots[i]] = change.values[i];
  return {.kind = Change::Kind::Values, .attribute = Attribute::Visibility, .slots = std::move(change.slots)};
}

Change take_scene(ReplicatedState& state, const ParsedPacket& packet) {
  const wire::Scene& body = *packet.root().body_as_Scene();
  const bool broadcast = packet.sequence() != 0;
  if (broadcast && body.version() <= state.quantized_scene.version) {
    throw StreamError(fmt::format("Scene: version {} where {} is held", body.version(), state.quantized_scene.version));
  }
  if (!broadcast && !body.whole()) throw StreamError("Scene: a snapshot's is not whole");
  QuantizedScene scene = decode_scene({body.state()->data(), body.state()->size()},
                                      body.whole() ? nullptr : &state.quantized_scene, body.version());
  dequantize_changes(state.quantized_scene, scene, state.scene);
  state.quantized_scene = std::move(scene);
  state.instant = {.frame = body.frame(), .capture_ns = packet.capture_ns()};
  std::vector<std::uint32_t> lights;
  for (const QuantizedSource& source : state.quantized_scene.sources) lights.push_back(source.id);
  return {.kind = Change::Kind::Scene, .lights_changed = state.light_rows.set_lights(lights, state.gaussians.count())};
}

}  // namespace

Change apply(ReplicatedState& state, const ParsedPacket& packet, std::size_t max_gaussians) {
  const auto payload = packet.payload();
  const wire::Packet& root = packet.root();
  switch (packet.body()) {
    case wire::Body::Snapshot:
      return append(state, *root.body_as_Snapshot(), payload, max_gaussians);
    case wire::Body::TensorDelta:
      return add_residuals(state, *root.body_as_TensorDelta(), payload);
    case wire::Body::LightVisibility:
      return take_visibility(state, *root.body_as_LightVisibility(), payload);
    case wire::Body::Remove: {
      const wire::Remove& body = *root.body_as_Remove();
      auto slots = decode_slots(payload, body.raw_bytes(), body.count(), state.gaussians.count());
      state.gaussians.remove(slots);
      state.light_rows.remove(slots);
      return {.kind = Change::Kind::Removed, .slots = std::move(slots)};
    }
    case wire::Body::GaussianOrder: {
      const wire::GaussianOrder& body = *root.body_as_GaussianOrder();
      require_range("GaussianOrder", body.first_slot(), body.count(), state.gaussians.count());
      const auto ids = decode_ids(payload, body.raw_bytes(), body.count());
      std::copy(ids.begin(), ids.end(), state.gaussians.gaussian_id.begin() + body.first_slot());
      return {};
    }
    case wire::Body::ObjectIds: {
      const wire::ObjectIds& body = *root.body_as_ObjectIds();
      require_range("ObjectIds", body.first_slot(), body.count(), state.gaussians.count());
      const auto ids = decode_runs(payload, body.raw_bytes(), body.count());
      std::copy(ids.begin(), ids.end(), state.gaussians.object_id.begin() + body.first_slot());
      return {.kind = Change::Kind::Objects, .slots = slot_range(body.first_slot(), body.count())};
    }
    case wire::Body::Scene:
      return take_scene(state, packet);
    default:
      throw StreamError(fmt::format("{}: not a packet that changes what is held", wire::EnumNameBody(packet.body())));
  }
}

}  // namespace splatbus::stream

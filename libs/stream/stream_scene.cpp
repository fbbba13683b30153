#include <fmt/format.h>

#include <cstdlib>

#include "stream/codecs.h"
#include "stream/scene_codec.h"
#include "stream/stream_model.h"

namespace splatbus::stream {

namespace {

constexpr std::size_t kLargeScene = std::size_t{1} << 16;  // bytes
constexpr int kVisibilityLevels = 31;  // between none and all: a 31st of the sun's light does not show

/// What is sent of it.
int level_of(int visibility) {
  const int level = (visibility * kVisibilityLevels + 127) / 255;
  return (level * 255 + kVisibilityLevels / 2) / kVisibilityLevels;
}

/// Values that waver between two levels rest; deep shadow and full light are exact.
bool differs(int visibility, int held) {
  const bool all_or_none = visibility == 0 || visibility == 255;
  return all_or_none ? visibility != held : std::abs(visibility - held) > StreamModel::kMaxVisibilityError;
}

}  // namespace

std::vector<EncodedPacket> StreamModel::take_scene(const SceneState& scene, const SceneInstant& instant) {
  if (scene.version == 0 || scene.version < scene_.version) {
    throw StreamError(fmt::format("scene: version {} after {}", scene.version, scene_.version));
  }
  if (scene.version == scene_.version) return {};
  scene_ = quantize_scene(scene);
  instant_ = instant;
  if (!ready_) return {};
  ready_ = false;  // until the mirror has it too
  std::vector<EncodedPacket> out{scene_packet(held_.sequence + 1, &held_.quantized_scene)};
  take_packet(out.back());
  ready_ = true;
  return out;
}

EncodedPacket StreamModel::scene_packet(std::uint64_t sequence, const QuantizedScene* base) const {
  Bytes encoded = encode_scene(scene_, base);
  if (base && encoded.size() > kLargeScene) {
    // Where everything goes and something else comes, what comes is less, and it always fits a packet.
    if (Bytes whole = encode_scene(scene_, nullptr); whole.size() < encoded.size()) {
      base = nullptr;
      encoded = std::move(whole);
    }
  }
  return brief_writer_.write(
      held_.epoch, sequence, wire::Body::Scene,
      [&](auto& builder) {
        const auto state = builder.CreateVector(encoded);
        return wire::CreateScene(builder, scene_.version, instant_.frame, base == nullptr, state);
      },
      {}, instant_.capture_ns);
}

void StreamModel::hold_scene() {
  held_.quantized_scene = scene_;
  held_.scene = dequantize_scene(scene_);
  held_.instant = instant_;
}

std::vector<EncodedPacket> StreamModel::take_visibility(std::span<const std::uint8_t> of_index,
                                                        std::uint64_t scene_version) {
  const AttributeChannels* a = held_.layout.find(Attribute::Visibility);
  if (!ready_ || !a || scene_version < held_.visibility_version) return {};
  const std::vector<std::int32_t>& held = held_.gaussians.channels[a->first];
  std::vector<std::uint8_t> wanted(held.begin(), held.end());
  std::size_t column = 0;
  for (const IndexRange& range : target_ranges_) {
    if (std::size_t{range.first} + range.count > of_index.size()) {
      throw StreamError(fmt::format("visibility: of {} indices, the model has more", of_index.size()));
    }
    for (std::uint32_t k = 0; k < range.count; ++k, ++column) {
      if (slot_of_column_[column] != kNotHeld) wanted[slot_of_column_[column]] = of_index[range.first + k];
    }
  }
  SlotValues change;
  for (std::size_t slot = 0; slot < held.size(); ++slot) {
    if (!differs(wanted[slot], held[slot])) continue;
    change.slots.push_back(static_cast<std::uint32_t>(slot));
    change.values.push_back(static_cast<std::uint8_t>(level_of(wanted[slot])));
  }
  if (change.slots.empty() && scene_version == held_.visibility_version) return {};
  Payload payload = encode_slot_values(change);
  ready_ = false;  // until the mirror has it too
  std::vector<EncodedPacket> out{brief_writer_.write(
      held_.epoch, held_.sequence + 1, wire::Body::LightVisibility,
      [&](auto& builder) {
        return wire::CreateLightVisibility(builder, scene_version, static_cast<std::uint32_t>(change.slots.size()),
                                           payload.raw_bytes);
      },
      std::move(payload.bytes))};
  take_packet(out.back());
  ready_ = true;
  return out;
}

}  // namespace splatbus::stream

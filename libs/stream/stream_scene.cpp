#include <fmt/format.h>

#include <algorithm>
#include <cstdlib>
#include <functional>
#include <utility>

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

float luminance(const glm::vec3& light) {
  return 0.2126F * light.x + 0.7152F * light.y + 0.0722F * light.z;
}

/// What a light brings to Gaussians that face it and see it.
class Illumination {
 public:
  Illumination(const ReplicatedState& state, std::uint32_t light_id)
      : state_(state),
        mean_(state.layout.at(Attribute::Mean)),
        everywhere_(luminance(state.scene.light.sun_irradiance)) {
    if (light_id == 0) return;
    const auto& sources = state.scene.light.sources;
    source_ = &*std::ranges::find(sources, light_id, &LightSource::id);
    if (source_->kind == LightKind::Directional) everywhere_ = luminance(source_->intensity);
  }

  [[nodiscard]] float at(std::size_t slot) const {
    if (!source_ || source_->kind == LightKind::Directional) return everywhere_;
    glm::vec3 point;
    for (int axis = 0; axis < 3; ++axis) {
      const auto q = static_cast<float>(state_.gaussians.channels[mean_.first + axis][slot]);
      point[axis] = mean_.quantizer.offset + mean_.quantizer.step * q;
    }
    const auto object = state_.scene.objects.find(state_.gaussians.object_id[slot]);
    if (object != state_.scene.objects.end()) point = object->second * point;
    return luminance(incident(*source_, point).irradiance);
  }

 private:
  const ReplicatedState& state_;
  const AttributeChannels& mean_;
  const LightSource* source_ = nullptr;
  float everywhere_;
};

}  // namespace

std::vector<EncodedPacket> StreamModel::take_scene(const SceneState& scene, const SceneInstant& instant) {
  QuantizedScene quantized;
  if (scene.version > scene_.version) quantized = quantize_scene(scene);
  const std::scoped_lock lock(mutex_);
  if (scene.version == 0 || scene.version < scene_.version) {
    throw StreamError(fmt::format("scene: version {} after {}", scene.version, scene_.version));
  }
  if (scene.version == scene_.version) return {};
  scene_ = std::move(quantized);
  instant_ = instant;
  if (!ready_) return {};
  take_packet(scene_packet(held_.sequence + 1, &held_.quantized_scene));
  return std::exchange(made_, {});
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
  std::vector<std::uint32_t> lights;
  for (const QuantizedSource& source : scene_.sources) lights.push_back(source.id);
  held_.light_rows = {};
  held_.light_rows.set_lights(lights, held_.gaussians.count());
}

StreamModel::LightChange StreamModel::change_of(std::uint32_t light_id, std::span<const std::uint8_t> of_index) const {
  LightChange out{.light_id = light_id, .change = {}, .weight = 0};
  Bytes held;
  if (light_id == 0) {
    const std::vector<std::int32_t>& plane = held_.gaussians.channels[held_.layout.at(Attribute::Visibility).first];
    held.assign(plane.begin(), plane.end());
  } else {
    held = *held_.light_rows.find(light_id);
  }
  Bytes wanted = held;
  std::size_t column = 0;
  for (const IndexRange& range : target_ranges_) {
    if (std::size_t{range.first} + range.count > of_index.size()) {
      throw StreamError(fmt::format("visibility: of {} indices, the model has more", of_index.size()));
    }
    for (std::uint32_t k = 0; k < range.count; ++k, ++column) {
      if (slot_of_column_[column] != kNotHeld) wanted[slot_of_column_[column]] = of_index[range.first + k];
    }
  }
  const Illumination light(held_, light_id);
  for (std::size_t slot = 0; slot < held.size(); ++slot) {
    if (!differs(wanted[slot], held[slot])) continue;
    out.change.slots.push_back(static_cast<std::uint32_t>(slot));
    out.change.values.push_back(static_cast<std::uint8_t>(level_of(wanted[slot])));
    out.weight += std::abs(wanted[slot] - held[slot]) * light.at(slot);
  }
  return out;
}

EncodedPacket StreamModel::light_packet(std::uint64_t sequence, const LightChange& light) const {
  Payload payload = encode_slot_values(light.change);
  return brief_writer_.write(
      held_.epoch, sequence, wire::Body::LightVisibility,
      [&](auto& builder) {
        return wire::CreateLightVisibility(builder, held_.visibility_version,
                                           static_cast<std::uint32_t>(light.change.slots.size()), payload.raw_bytes,
                                           light.light_id);
      },
      std::move(payload.bytes));
}

std::vector<EncodedPacket> StreamModel::take_visibility(const LightsVisibility& visibility, double budget_bytes) {
  if (!ready_ || !held_.layout.find(Attribute::Visibility)) return {};
  if (visibility.scene_version < held_.visibility_version || visibility.light_ids.empty()) return {};
  const std::size_t indices = visibility.of_index.size() / visibility.light_ids.size();
  std::vector<LightChange> changes;
  for (std::size_t k = 0; k < visibility.light_ids.size(); ++k) {
    const std::uint32_t id = visibility.light_ids[k];
    if (id != 0 && !held_.light_rows.find(id)) continue;
    LightChange light = change_of(id, visibility.of_index.subspan(k * indices, indices));
    if (light.change.slots.empty()) continue;
    if (const auto waits = visibility_waits_.find(id); waits != visibility_waits_.end())
      light.weight *= 1 + waits->second;
    changes.push_back(std::move(light));
  }
  // Nothing has changed: that is worth a packet, once.
  if (changes.empty() && visibility.scene_version != held_.visibility_version) changes.emplace_back();
  std::ranges::stable_sort(changes, std::greater<>{}, &LightChange::weight);
  std::map<std::uint32_t, std::uint32_t> waits;
  const std::scoped_lock lock(mutex_);
  held_.visibility_version = visibility.scene_version;
  bool any = false;
  for (const LightChange& light : changes) {
    if (std::exchange(any, true) && budget_bytes <= 0) {
      waits[light.light_id] = visibility_waits_[light.light_id] + 1;
      continue;
    }
    take_packet(light_packet(held_.sequence + 1, light));
    budget_bytes -= static_cast<double>(made_.back().bytes());
  }
  visibility_waits_ = std::move(waits);
  return std::exchange(made_, {});
}

std::vector<EncodedPacket> StreamModel::light_rows() const {
  std::vector<EncodedPacket> out;
  for (const auto& [id, row] : held_.light_rows.all()) {
    LightChange light{.light_id = id, .change = {}, .weight = 0};
    for (std::size_t slot = 0; slot < row.size(); ++slot) {
      if (row[slot] == 255) continue;
      light.change.slots.push_back(static_cast<std::uint32_t>(slot));
      light.change.values.push_back(row[slot]);
    }
    if (!light.change.slots.empty()) out.push_back(light_packet(0, light));
  }
  return out;
}

}  // namespace splatbus::stream

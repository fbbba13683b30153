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
constexpr std::size_t kPacketEntries = std::size_t{1} << 14;
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

/// With all its fields: another streamer that sends it on writes the scene's version anew.
auto create_visibility(flatbuffers::FlatBufferBuilder& builder, std::uint64_t version, std::uint32_t light,
                       const std::vector<wire::SeenPage>& pages, std::uint32_t count, std::uint32_t raw_bytes) {
  const auto pages_at = builder.CreateVectorOfStructs(pages);
  builder.ForceDefaults(true);
  const auto visibility = wire::CreateLightVisibility(builder, version, light, pages_at, count, raw_bytes);
  builder.ForceDefaults(false);
  return visibility;
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

  [[nodiscard]] float at(std::uint32_t row) const {
    if (!source_ || source_->kind == LightKind::Directional) return everywhere_;
    glm::vec3 point;
    for (int axis = 0; axis < 3; ++axis) {
      const auto q = static_cast<float>(state_.gaussians.channels[mean_.first + axis][row]);
      point[axis] = mean_.quantizer.offset + mean_.quantizer.step * q;
    }
    const auto object = state_.scene.objects.find(state_.gaussians.object_id[row]);
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

std::optional<EncodedPacket> StreamModel::take_scene(const SceneState& scene, const SceneInstant& instant) {
  const std::uint64_t before = scene_version();
  QuantizedScene quantized;
  if (scene.version > before) quantized = quantize_scene(scene);
  if (scene.version == 0 || scene.version < before) {
    throw StreamError(fmt::format("scene: version {} after {}", scene.version, before));
  }
  if (scene.version == before) return std::nullopt;
  const std::scoped_lock lock(mutex_);
  scene_ = std::move(quantized);
  instant_ = instant;
  if (!ready_) return std::nullopt;
  const bool first = held_.quantized_scene.version == 0;
  EncodedPacket packet = write_scene(first ? nullptr : &held_.quantized_scene);
  (void)apply(held_, ParsedPacket::parse(packet.packet, packet.payload), kMaxGaussians);
  return packet;
}

std::uint64_t StreamModel::scene_version() const {
  const std::scoped_lock lock(mutex_);
  return scene_.version;
}

std::optional<EncodedPacket> StreamModel::scene_packet() const {
  const std::scoped_lock lock(mutex_);
  if (!ready_ || scene_.version == 0) return std::nullopt;
  return write_scene(nullptr);
}

EncodedPacket StreamModel::write_scene(const QuantizedScene* base) const {
  Bytes encoded = encode_scene(scene_, base);
  if (base && encoded.size() > kLargeScene) {
    // Where everything goes and something else comes, what comes is less, and it always fits a packet.
    if (Bytes whole = encode_scene(scene_, nullptr); whole.size() < encoded.size()) {
      base = nullptr;
      encoded = std::move(whole);
    }
  }
  return brief_writer_.write(
      held_.epoch, 0, wire::Body::Scene,
      [&](auto& builder) {
        const auto state = builder.CreateVector(encoded);
        return wire::CreateScene(builder, scene_.version, base ? base->version : 0, instant_.frame, state);
      },
      {}, instant_.capture_ns);
}

void StreamModel::hold_scene() {
  held_.quantized_scene = scene_;
  held_.scene = dequantize_scene(scene_);
  held_.instant = instant_;
  held_.renew_light_rows();
}

StreamModel::LightChange StreamModel::change_of(std::uint32_t light_id, std::span<const std::uint8_t> of_index,
                                                const LightsVisibility& all) const {
  LightChange out{.light_id = light_id, .rows = {}, .values = {}, .weight = 0};
  const HeldChannel* sun =
      light_id == 0 ? &held_.gaussians.channels[held_.layout.at(Attribute::Visibility).first] : nullptr;
  const Bytes* others = light_id != 0 ? held_.light_rows.find(light_id) : nullptr;
  const Illumination light(held_, light_id);
  for (const TargetPage& page : target_pages_) {
    if (std::size_t{page.first} + page.count > of_index.size()) {
      throw StreamError(fmt::format("visibility: of {} indices, the model has more", of_index.size()));
    }
    if (!all.covered.empty() && all.covered[page.first / all.page_indices] == 0) continue;
    for (std::uint32_t k = 0; k < page.count; ++k) {
      const std::uint32_t row = row_of_column_[page.first + k];
      if (row == kNotHeld || target_page_of_row_[row] != page.page) continue;
      const int held = sun ? (*sun)[row] : (*others)[row];
      const int wanted = of_index[page.first + k];
      if (!differs(wanted, held)) continue;
      out.rows.push_back(row);
      out.values.push_back(static_cast<std::uint8_t>(level_of(wanted)));
      out.weight += std::abs(wanted - held) * light.at(row);
    }
  }
  return out;
}

VisibilityPacket StreamModel::write_visibility(const LightChange& light) const {
  std::map<std::uint32_t, std::vector<std::pair<std::uint32_t, std::uint8_t>>> pages;  // lane, value
  for (std::size_t i = 0; i < light.rows.size(); ++i) {
    pages[page_of_row(light.rows[i])].emplace_back(lane_of_row(light.rows[i]), light.values[i]);
  }
  SlotValues change;
  VisibilityPacket out;
  std::uint32_t first = 0;
  for (auto& [number, lanes] : pages) {
    const HeldPage& page = *held_.find(number);
    std::ranges::sort(lanes);
    for (const auto& [lane, value] : lanes) {
      change.slots.push_back(first + lane);
      change.values.push_back(value);
    }
    out.pages.emplace_back(number, page.structure, page.count);
    first += page.count;
  }
  Payload payload = encode_slot_values(change);
  out.packet = brief_writer_.write(
      held_.epoch, 0, wire::Body::LightVisibility,
      [&](auto& builder) {
        return create_visibility(builder, held_.visibility_version, light.light_id, out.pages,
                                 static_cast<std::uint32_t>(change.slots.size()), payload.raw_bytes);
      },
      std::move(payload.bytes));
  return out;
}

std::vector<VisibilityPacket> StreamModel::take_visibility(const LightsVisibility& visibility, double budget_bytes) {
  if (!ready_ || !held_.layout.find(Attribute::Visibility)) return {};
  if (visibility.scene_version < held_.visibility_version || visibility.light_ids.empty()) return {};
  const std::size_t indices = visibility.of_index.size() / visibility.light_ids.size();
  std::vector<LightChange> changes;
  for (std::size_t k = 0; k < visibility.light_ids.size(); ++k) {
    const std::uint32_t id = visibility.light_ids[k];
    if (id != 0 && !held_.light_rows.find(id)) continue;
    LightChange light = change_of(id, visibility.of_index.subspan(k * indices, indices), visibility);
    if (light.rows.empty()) continue;
    if (const auto waits = visibility_waits_.find(id); waits != visibility_waits_.end())
      light.weight *= 1 + waits->second;
    changes.push_back(std::move(light));
  }
  // Nothing has changed: that is worth a packet, once.
  if (changes.empty() && visibility.scene_version != held_.visibility_version) changes.emplace_back();
  std::ranges::stable_sort(changes, std::greater<>{}, &LightChange::weight);
  std::map<std::uint32_t, std::uint32_t> waits;
  std::vector<VisibilityPacket> out;
  const std::scoped_lock lock(mutex_);
  held_.visibility_version = visibility.scene_version;
  for (const LightChange& light : changes) {
    if (!out.empty() && budget_bytes <= 0) {
      waits[light.light_id] = visibility_waits_[light.light_id] + 1;
      continue;
    }
    for (std::size_t first = 0; first == 0 || first < light.rows.size(); first += kPacketEntries) {
      const std::size_t end = std::min(first + kPacketEntries, light.rows.size());
      LightChange part{.light_id = light.light_id, .rows = {}, .values = {}, .weight = 0};
      part.rows.assign(light.rows.begin() + static_cast<std::ptrdiff_t>(first),
                       light.rows.begin() + static_cast<std::ptrdiff_t>(end));
      part.values.assign(light.values.begin() + static_cast<std::ptrdiff_t>(first),
                         light.values.begin() + static_cast<std::ptrdiff_t>(end));
      out.push_back(write_visibility(part));
      const EncodedPacket& packet = out.back().packet;
      (void)apply(held_, ParsedPacket::parse(packet.packet, packet.payload), kMaxGaussians);
      budget_bytes -= static_cast<double>(packet.bytes());
    }
  }
  visibility_waits_ = std::move(waits);
  return out;
}

std::vector<EncodedPacket> StreamModel::page_visibility(std::uint32_t number) const {
  const std::scoped_lock lock(mutex_);
  const HeldPage* page = held_.find(number);
  const AttributeChannels* sun = held_.layout.find(Attribute::Visibility);
  if (!ready_ || !page || !sun) return {};
  std::vector<EncodedPacket> out;
  const auto add = [&](std::uint32_t id, auto&& value) {
    SlotValues all;
    for (std::uint32_t lane = 0; lane < page->count; ++lane) {
      all.slots.push_back(lane);
      all.values.push_back(static_cast<std::uint8_t>(value(page->row(lane))));
    }
    Payload payload = encode_slot_values(all);
    const std::vector<wire::SeenPage> pages{{number, page->structure, page->count}};
    out.push_back(brief_writer_.write(
        held_.epoch, 0, wire::Body::LightVisibility,
        [&](auto& builder) {
          return create_visibility(builder, held_.visibility_version, id, pages, page->count, payload.raw_bytes);
        },
        std::move(payload.bytes)));
  };
  add(0, [&](std::uint32_t row) { return held_.gaussians.channels[sun->first][row]; });
  for (const auto& [id, row] : held_.light_rows.all()) {
    add(id, [&values = row](std::uint32_t r) { return values[r]; });
  }
  return out;
}

}  // namespace splatbus::stream

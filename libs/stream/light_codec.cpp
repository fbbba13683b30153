#include "stream/light_codec.h"

#include "stream/scene_parts.h"

namespace splatbus::stream {

using namespace scene_parts;

namespace {

// Parts of the light, and of a source.
constexpr unsigned kSunDirection = 1, kSunIrradiance = 2, kBackground = 4, kAmbient = 8, kSources = 16;
constexpr unsigned kAllLight = 15;  // that a whole scene has
constexpr unsigned kDirection = 4, kIntensity = 8, kReach = 16;
constexpr unsigned kKindBits = 2;

void require_not_negative(const SharedExponent<3>& color, const char* field) {
  if (std::any_of(color.mantissa.begin(), color.mantissa.end(), [](std::int16_t mantissa) { return mantissa < 0; })) {
    refuse(fmt::format("{} is negative", field));
  }
}

/// The parts that a source of this kind has.
unsigned parts_of(LightKind kind) {
  switch (kind) {
    case LightKind::Directional:
      return kDirection | kIntensity;
    case LightKind::Point:
      return kPosition | kIntensity | kReach;
    case LightKind::Spot:
      break;
  }
  return kPosition | kDirection | kIntensity | kReach;
}

void put_sources(Bytes& out, const std::vector<QuantizedSource>& sources, std::vector<QuantizedSource> before) {
  // One that becomes of another kind goes and comes.
  std::vector<std::uint32_t> other;
  for (const QuantizedSource& source : sources) {
    const auto old =
        std::find_if(before.begin(), before.end(), [&](const QuantizedSource& held) { return held.id == source.id; });
    if (old != before.end() && (old->kind != source.kind || old->casts_shadow != source.casts_shadow)) {
      other.push_back(source.id);
      before.erase(old);
    }
  }
  Difference<QuantizedSource> difference(sources, before);
  difference.vanished.insert(difference.vanished.end(), other.begin(), other.end());
  std::sort(difference.vanished.begin(), difference.vanished.end());
  put_ids(out, difference.vanished);
  put_varint(out, difference.changed.size());
  Ids ids;
  for (const auto& [now, held] : difference.changed) {
    static constexpr QuantizedSource kNone;
    const QuantizedSource& old = held ? *held : kNone;
    ids.put(out, now->id);
    unsigned parts = parts_of(now->kind);
    if (held) {
      parts = (now->position != old.position ? kPosition : 0U) | (now->direction != old.direction ? kDirection : 0U) |
              (now->intensity != old.intensity ? kIntensity : 0U);
      if (now->range_m != old.range_m || now->inner != old.inner || now->outer != old.outer) parts |= kReach;
    }
    out.push_back(static_cast<std::uint8_t>(held ? parts : kAppears));
    if (!held) {
      out.push_back(
          static_cast<std::uint8_t>(static_cast<unsigned>(now->kind) | (now->casts_shadow ? 1U << kKindBits : 0U)));
    }
    if (parts & kPosition) put_position(out, now->position, old.position);
    if (parts & kDirection) put_direction(out, now->direction);
    if (parts & kIntensity) put(out, now->intensity, old.intensity);
    if (parts & kReach) {
      put(out, now->range_m, old.range_m);
      if (now->kind == LightKind::Spot) {
        put_varint(out, zigzag(now->inner - old.inner));
        put_varint(out, zigzag(now->outer - old.outer));
      }
    }
  }
}

void read_source(ByteReader& reader, unsigned parts, QuantizedSource& source) {
  const std::string what = fmt::format("light {}", source.id);
  if (source.id == 0) refuse(what + " is the sun");
  if (parts & kAppears) {
    if (parts != kAppears) refuse(fmt::format("{}: parts {}", what, parts));
    const std::uint64_t kind = reader.low_bytes(1);
    if ((kind & ((1U << kKindBits) - 1)) > static_cast<unsigned>(LightKind::Spot) || kind >> (kKindBits + 1) != 0) {
      refuse(fmt::format("{}: kind {}", what, kind));
    }
    source.kind = static_cast<LightKind>(kind & ((1U << kKindBits) - 1));
    source.casts_shadow = kind >> kKindBits != 0;
    parts = parts_of(source.kind);
  } else if ((parts & ~parts_of(source.kind)) != 0) {
    refuse(fmt::format("{}: parts {}", what, parts));
  }
  if (parts & kPosition) read_position(reader, source.position, "light", source.id);
  if (parts & kDirection) read_direction(reader, source.direction);
  if (parts & kIntensity) {
    read(reader, source.intensity, (what + ": its intensity").c_str());
    require_not_negative(source.intensity, (what + ": its intensity").c_str());
  }
  if (!(parts & kReach)) return;
  read(reader, source.range_m, (what + ": its range").c_str());
  if (source.range_m.mantissa[0] <= 0) refuse(what + ": its range is not above 0");
  if (source.kind != LightKind::Spot) return;
  source.inner = read_steps(reader, source.inner, kMaxCosineSteps, what + ": its cone");
  source.outer = read_steps(reader, source.outer, kMaxCosineSteps, what + ": its cone");
  if (source.inner <= source.outer) refuse(what + ": its cone is not valid");
}

}  // namespace

void put_light(Bytes& out, const QuantizedScene& scene, const QuantizedScene* base) {
  static const QuantizedScene kNone;
  const QuantizedScene& held = base ? *base : kNone;
  const QuantizedLight &light = scene.light, &before = held.light;
  unsigned parts = kAllLight;
  if (base) {
    parts = (light.sun_direction != before.sun_direction ? kSunDirection : 0U) |
            (light.sun_irradiance != before.sun_irradiance ? kSunIrradiance : 0U) |
            (light.background != before.background ? kBackground : 0U) |
            (light.ambient != before.ambient ? kAmbient : 0U);
  }
  if (scene.sources != held.sources) parts |= kSources;
  out.push_back(static_cast<std::uint8_t>(parts));
  put_varint(out, zigzag(static_cast<std::int64_t>(scene.light_generation - held.light_generation)));
  if (parts & kSunDirection) put_direction(out, light.sun_direction);
  if (parts & kSunIrradiance) put(out, light.sun_irradiance, before.sun_irradiance);
  if (parts & kBackground) put(out, light.background, before.background);
  if (parts & kAmbient) put(out, light.ambient, before.ambient);
  if (parts & kSources) put_sources(out, scene.sources, held.sources);
}

void read_light(ByteReader& reader, QuantizedScene& scene, bool whole) {
  const std::uint64_t parts = reader.low_bytes(1);
  if (parts > (kAllLight | kSources) || (whole && (parts & kAllLight) != kAllLight)) {
    refuse(fmt::format("parts {} of a light", parts));
  }
  scene.light_generation += static_cast<std::uint64_t>(unzigzag(reader.varint()));
  if (parts & kSunDirection) read_direction(reader, scene.light.sun_direction);
  if (parts & kSunIrradiance) read(reader, scene.light.sun_irradiance, "sun_irradiance");
  if (parts & kBackground) read(reader, scene.light.background, "background");
  if (parts & kAmbient) read(reader, scene.light.ambient, "ambient");
  require_not_negative(scene.light.sun_irradiance, "sun_irradiance");
  require_not_negative(scene.light.background, "background");
  if (!(parts & kSources)) return;
  read_vanished(reader, scene.sources, "light");
  read_changed(reader, scene.sources, kMaxLightSources, "light",
               [&](QuantizedSource& source, unsigned p) { read_source(reader, p, source); });
}

}  // namespace splatbus::stream

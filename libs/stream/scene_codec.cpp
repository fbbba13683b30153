#include "stream/scene_codec.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstdlib>
#include <string>
#include <string_view>
#include <vector>

#include "stream/layout.h"

namespace splatbus::stream {

namespace {

constexpr std::string_view kWhat = "Scene";
constexpr int kRotationBytes = 6;

// Parts of a light, and of an object.
enum LightPart : std::uint8_t { kSunDirection = 1, kSunIrradiance = 2, kBackground = 4, kAmbient = 8, kAllLight = 15 };
enum ObjectPart : std::uint8_t { kAppears = 1, kPosition = 2, kRotation = 4 };

[[noreturn]] void refuse(const std::string& why) {
  throw StreamError(fmt::format("{}: {}", kWhat, why));
}

void put_varint(Bytes& out, std::uint64_t value) {
  for (; value >= 0x80; value >>= 7) out.push_back(static_cast<std::uint8_t>(value | 0x80));
  out.push_back(static_cast<std::uint8_t>(value));
}

void put_low_bytes(Bytes& out, std::uint64_t value, int count) {
  for (int i = 0; i < count; ++i) out.push_back(static_cast<std::uint8_t>(value >> (8 * i)));
}

template <std::size_t N>
void put(Bytes& out, const SharedExponent<N>& shared, const SharedExponent<N>& before) {
  out.push_back(static_cast<std::uint8_t>(shared.exponent));
  for (std::size_t i = 0; i < N; ++i) put_varint(out, zigzag(shared.mantissa[i] - before.mantissa[i]));
}

std::int16_t read_i16(ByteReader& reader) {
  return static_cast<std::int16_t>(reader.low_bytes(2));
}

template <std::size_t N>
void read(ByteReader& reader, SharedExponent<N>& shared, const char* field) {
  shared.exponent = static_cast<std::int8_t>(reader.low_bytes(1));
  for (std::int16_t& mantissa : shared.mantissa) {
    const std::int64_t change = unzigzag(reader.varint());
    if (std::abs(change / 2) > kMaxMantissa || std::abs(mantissa + change) > kMaxMantissa) {
      refuse(fmt::format("{} is out of bounds", field));
    }
    mantissa = static_cast<std::int16_t>(mantissa + change);
  }
}

void require_not_negative(const SharedExponent<3>& color, const char* field) {
  if (std::ranges::any_of(color.mantissa, [](std::int16_t mantissa) { return mantissa < 0; })) {
    refuse(fmt::format("{} is negative", field));
  }
}

void put_light(Bytes& out, const QuantizedScene& scene, const QuantizedScene* base) {
  static const QuantizedLight kNone;
  const QuantizedLight &light = scene.light, &before = base ? base->light : kNone;
  unsigned parts = kAllLight;
  if (base) {
    parts = (light.sun_direction != before.sun_direction ? kSunDirection : 0U) |
            (light.sun_irradiance != before.sun_irradiance ? kSunIrradiance : 0U) |
            (light.background != before.background ? kBackground : 0U) |
            (light.ambient != before.ambient ? kAmbient : 0U);
  }
  out.push_back(static_cast<std::uint8_t>(parts));
  put_varint(out, zigzag(static_cast<std::int64_t>(scene.light_generation - (base ? base->light_generation : 0))));
  if (parts & kSunDirection) {
    for (const std::int16_t e : light.sun_direction) put_low_bytes(out, static_cast<std::uint16_t>(e), 2);
  }
  if (parts & kSunIrradiance) put(out, light.sun_irradiance, before.sun_irradiance);
  if (parts & kBackground) put(out, light.background, before.background);
  if (parts & kAmbient) put(out, light.ambient, before.ambient);
}

void read_light(ByteReader& reader, QuantizedScene& scene, bool whole) {
  const std::uint64_t parts = reader.low_bytes(1);
  if (parts > kAllLight || (whole && parts != kAllLight)) refuse(fmt::format("parts {} of a light", parts));
  scene.light_generation += static_cast<std::uint64_t>(unzigzag(reader.varint()));
  if (parts & kSunDirection) {
    for (std::int16_t& e : scene.light.sun_direction) e = read_i16(reader);
  }
  if (parts & kSunIrradiance) read(reader, scene.light.sun_irradiance, "sun_irradiance");
  if (parts & kBackground) read(reader, scene.light.background, "background");
  if (parts & kAmbient) read(reader, scene.light.ambient, "ambient");
  require_not_negative(scene.light.sun_irradiance, "sun_irradiance");
  require_not_negative(scene.light.background, "background");
}

/// Ids ascend: each is written as what it is beyond the one before and one more.
class Ids {
 public:
  void put(Bytes& out, std::uint32_t id) {
    put_varint(out, id - next_);
    next_ = std::uint64_t{id} + 1;
  }
  std::uint32_t read(ByteReader& reader) {
    const std::uint64_t gap = reader.varint();
    if (gap > 0xFFFFFFFFU || next_ + gap > 0xFFFFFFFFU) refuse("an object id above 32 bits");
    const auto id = static_cast<std::uint32_t>(next_ + gap);
    next_ = std::uint64_t{id} + 1;
    return id;
  }

 private:
  std::uint64_t next_ = 0;
};

void put_objects(Bytes& out, const QuantizedScene& scene, const QuantizedScene& base) {
  struct Changed {
    std::uint32_t id;
    unsigned parts;
    const QuantizedTransform *transform, *before;
  };
  static constexpr QuantizedTransform kNone;
  std::vector<Changed> changed;
  std::vector<std::uint32_t> vanished;
  for (const auto& [id, transform] : scene.objects) {
    const auto before = base.objects.find(id);
    if (before == base.objects.end()) {
      changed.push_back({id, kAppears, &transform, &kNone});
    } else if (before->second != transform) {
      const unsigned parts = (transform.position != before->second.position ? kPosition : 0U) |
                             (transform.rotation != before->second.rotation ? kRotation : 0U);
      changed.push_back({id, parts, &transform, &before->second});
    }
  }
  for (const auto& [id, transform] : base.objects) {
    if (!scene.objects.contains(id)) vanished.push_back(id);
  }
  put_varint(out, vanished.size());
  for (Ids ids; const std::uint32_t id : vanished) ids.put(out, id);
  put_varint(out, changed.size());
  for (Ids ids; const Changed& object : changed) {
    ids.put(out, object.id);
    out.push_back(static_cast<std::uint8_t>(object.parts));
    if (object.parts & (kAppears | kPosition)) {
      for (std::size_t axis = 0; axis < 3; ++axis) {
        put_varint(out, zigzag(object.transform->position[axis] - object.before->position[axis]));
      }
    }
    if (object.parts & (kAppears | kRotation)) put_low_bytes(out, object.transform->rotation, kRotationBytes);
  }
}

void read_transform(ByteReader& reader, std::uint64_t parts, std::uint32_t id, QuantizedTransform& transform) {
  if (parts & (kAppears | kPosition)) {
    for (std::int64_t& position : transform.position) {
      const std::int64_t change = unzigzag(reader.varint());
      if (std::abs(change / 2) > kMaxPositionSteps || std::abs(position + change) > kMaxPositionSteps) {
        refuse(fmt::format("object {}: its position is out of bounds", id));
      }
      position += change;
    }
  }
  if (parts & (kAppears | kRotation)) {
    transform.rotation = reader.low_bytes(kRotationBytes);
    if (!is_rotation(transform.rotation)) refuse(fmt::format("object {}: its rotation is none", id));
  }
}

void read_objects(ByteReader& reader, QuantizedScene& scene) {
  const std::uint64_t vanished = reader.varint();
  if (vanished > scene.objects.size()) {
    refuse(fmt::format("{} objects vanish of {}", vanished, scene.objects.size()));
  }
  Ids ids;
  for (std::uint64_t i = 0; i < vanished; ++i) {
    const std::uint32_t id = ids.read(reader);
    if (scene.objects.erase(id) == 0) refuse(fmt::format("object {} vanishes and is not there", id));
  }
  const std::uint64_t changed = reader.varint();
  if (changed > kMaxObjects) refuse(fmt::format("{} objects, at most {}", changed, kMaxObjects));
  ids = {};
  for (std::uint64_t i = 0; i < changed; ++i) {
    const std::uint32_t id = ids.read(reader);
    const std::uint64_t parts = reader.low_bytes(1);
    const bool appears = parts == kAppears;
    if (!appears && (parts == 0 || (parts & ~std::uint64_t{kPosition | kRotation}) != 0)) {
      refuse(fmt::format("object {}: parts {}", id, parts));
    }
    if (appears == scene.objects.contains(id)) {
      refuse(fmt::format("object {} {}", id, appears ? "appears and is there" : "changes and is not there"));
    }
    read_transform(reader, parts, id, scene.objects[id]);
  }
  if (scene.objects.size() > kMaxObjects)
    refuse(fmt::format("{} objects, at most {}", scene.objects.size(), kMaxObjects));
}

}  // namespace

Bytes encode_scene(const QuantizedScene& scene, const QuantizedScene* base) {
  static const QuantizedScene kEmpty;
  Bytes out;
  put_light(out, scene, base);
  put_objects(out, scene, base ? *base : kEmpty);
  return out;
}

QuantizedScene decode_scene(std::span<const std::uint8_t> bytes, const QuantizedScene* base, std::uint64_t version) {
  ByteReader reader(bytes, kWhat);
  QuantizedScene scene = base ? *base : QuantizedScene{};
  scene.version = version;
  read_light(reader, scene, base == nullptr);
  read_objects(reader, scene);
  reader.finish();
  return scene;
}

}  // namespace splatbus::stream

#include "stream/scene_codec.h"

#include "stream/layout.h"
#include "stream/light_codec.h"
#include "stream/scene_parts.h"

namespace splatbus::stream {

using namespace scene_parts;

namespace {

constexpr int kRotationBytes = 6;
constexpr unsigned kRotation = 4, kScale = 8, kFlags = 16;  // parts of an object
constexpr unsigned kAllFlags = 3;

void put_objects(Bytes& out, const QuantizedScene& scene, const QuantizedScene& base) {
  const Difference<QuantizedObject> difference(scene.objects, base.objects);
  put_ids(out, difference.vanished);
  put_varint(out, difference.changed.size());
  Ids ids;
  for (const auto& [object, held] : difference.changed) {
    static constexpr QuantizedTransform kNone;
    const QuantizedTransform &now = object->transform, &old = held ? held->transform : kNone;
    const unsigned place =
        (now.position != old.position ? kPosition : 0U) | (now.rotation != old.rotation ? kRotation : 0U);
    const unsigned parts =
        (held ? place : kAppears) | (now.scale != old.scale ? kScale : 0U) | (now.flags != old.flags ? kFlags : 0U);
    ids.put(out, object->id);
    out.push_back(static_cast<std::uint8_t>(parts));
    if (parts & (kAppears | kPosition)) put_position(out, now.position, old.position);
    if (parts & (kAppears | kRotation)) put_low_bytes(out, now.rotation, kRotationBytes);
    if (parts & kScale) put_varint(out, zigzag(now.scale - old.scale));
    if (parts & kFlags) out.push_back(now.flags);
  }
}

void read_object(ByteReader& reader, unsigned parts, QuantizedObject& object) {
  const std::uint32_t id = object.id;
  QuantizedTransform& transform = object.transform;
  const unsigned allowed = parts & kAppears ? kAppears | kScale | kFlags : kPosition | kRotation | kScale | kFlags;
  if ((parts & ~allowed) != 0) refuse(fmt::format("object {}: parts {}", id, parts));
  if (parts & (kAppears | kPosition)) read_position(reader, transform.position, "object", id);
  if (parts & (kAppears | kRotation)) {
    transform.rotation = reader.low_bytes(kRotationBytes);
    if (!is_rotation(transform.rotation)) refuse(fmt::format("object {}: its rotation is not valid", id));
  }
  if (parts & kScale) {
    transform.scale = read_steps(reader, transform.scale, kMaxScaleOctaves * kScaleStepsAnOctave,
                                 fmt::format("object {}: its scale", id));
  }
  if (!(parts & kFlags)) return;
  transform.flags = static_cast<std::uint8_t>(reader.low_bytes(1));
  if (transform.flags > kAllFlags) refuse(fmt::format("object {}: flags {}", id, transform.flags));
}

void read_objects(ByteReader& reader, QuantizedScene& scene) {
  read_vanished(reader, scene.objects, "object");
  read_changed(reader, scene.objects, kMaxObjects, "object",
               [&](QuantizedObject& object, unsigned parts) { read_object(reader, parts, object); });
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

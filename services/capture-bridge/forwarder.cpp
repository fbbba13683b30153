#include "capture-bridge/forwarder.h"

#include "bus/memory.h"
#include "wire/capture_generated.h"
#include "wire/convert.h"
#include "wire/scene_generated.h"

namespace splatbus::capture_bridge {

namespace {

constexpr std::size_t kLightDepthSlots = 3;

std::vector<std::uint8_t> object_bytes(const wire::EngineFrame& frame) {
  const auto* objects = frame.scene()->objects();
  if (objects == nullptr || objects->size() == 0) return {};
  const auto* begin = reinterpret_cast<const std::uint8_t*>(objects->Get(0));
  return {begin, begin + objects->size() * sizeof(wire::ObjectTransform)};
}

/// A light as bytes, without padding, to compare.
std::vector<std::uint8_t> light_bytes(const Light& light) {
  std::vector<std::uint8_t> bytes;
  const auto append = [&bytes](const auto& value) {
    const auto* begin = reinterpret_cast<const std::uint8_t*>(&value);
    bytes.insert(bytes.end(), begin, begin + sizeof(value));
  };
  append(light.generation);
  append(light.ambient_sh);
  append(light.sun_direction);
  append(light.sun_irradiance);
  append(light.background);
  return bytes;
}

}  // namespace

Forwarder::Forwarder(const std::shared_ptr<bus::Context>& context, Device kind)
    : publisher_(context),
      light_depth_copies_(kind),
      light_depth_ring_(context, "light_depth", kLightDepthSlots, 0, kind) {}

bool Forwarder::reference(const bus::Message& message, const wire::EngineFrame& frame) {
  bus::MessageInfo info{.capture_ns = frame.header()->capture_ns()};
  auto color = message.forward_tensor("color");
  if (!color) return false;
  info.tensors.push_back(std::move(*color));
  for (const char* name : {"albedo", "depth"}) {
    if (auto tensor = message.forward_tensor(name)) info.tensors.push_back(std::move(*tensor));
  }
  const Camera camera = from_wire(*frame.camera());
  const SceneState scene = from_wire(*frame.scene());
  publisher_.publish(topics::kCaptureReference, info, [&](flatbuffers::FlatBufferBuilder& builder, auto header) {
    const auto scene_offset = to_wire(builder, scene, frame.scene()->frame(), frame.scene()->time_s());
    const wire::Camera out = to_wire(camera);
    return wire::CreateCaptureReference(builder, header, &out, scene_offset, false);
  });
  return true;
}

void Forwarder::retire(const Camera& camera) {
  publisher_.publish(topics::kCaptureReference, [&](flatbuffers::FlatBufferBuilder& builder, auto header) {
    const auto scene = to_wire(builder, SceneState{.light = last_light_, .objects = {}});
    const wire::Camera out = to_wire(camera);
    return wire::CreateCaptureReference(builder, header, &out, scene, true);
  });
}

bool Forwarder::probe(const bus::Message& message, const wire::EngineFrame& frame, const Probe& probe) {
  auto color = message.forward_tensor("color");
  if (!color) return false;
  Camera camera = from_wire(*frame.camera());
  camera.id = probe.camera.id;
  const SceneState scene = from_wire(*frame.scene());
  publisher_.publish(
      topics::kCaptureProbe, {.capture_ns = frame.header()->capture_ns(), .tensors = {std::move(*color)}},
      [&](flatbuffers::FlatBufferBuilder& builder, auto header) {
        const auto scene_offset = to_wire(builder, scene, frame.scene()->frame(), frame.scene()->time_s());
        const wire::Camera out = to_wire(camera);
        return wire::CreateCaptureProbe(builder, header, probe.probe_id, &out, scene_offset);
      });
  return true;
}

bool Forwarder::light_depth(const bus::Message& message, const wire::EngineFrame& frame,
                            std::atomic<std::uint64_t>& host_bytes) {
  const Camera camera = from_wire(*frame.camera());
  const auto depth = message.tensor("light_depth", bus::ElementType::F32, {camera.height, camera.width});
  if (!depth) return false;
  // Through a copy, so that a depth that is gone costs no slot of the ring.
  const Device kind = light_depth_copies_.kind();
  const auto copy = light_depth_copies_.take(depth->bytes());
  if (!bus::copy_tensor(*depth, copy.get(), kind, host_bytes)) return false;
  const bus::TensorSource source{"light_depth", {camera.height, camera.width}, bus::ElementType::F32, copy.get(), kind};
  const SceneState scene = from_wire(*frame.scene());
  const bus::MessageInfo info{.capture_ns = frame.header()->capture_ns(),
                              .tensors = light_depth_ring_.write(std::span(&source, 1))};
  publisher_.publish(topics::kSceneLightDepth, info, [&](flatbuffers::FlatBufferBuilder& builder, auto header) {
    const auto scene_offset = to_wire(builder, scene, frame.scene()->frame(), frame.scene()->time_s());
    const wire::Camera out = to_wire(camera);
    return wire::CreateSceneLightDepth(builder, header, &out, scene_offset);
  });
  return true;
}

void Forwarder::scene(const wire::EngineFrame& frame) {
  const bool restarted = frame.header()->epoch() != engine_epoch_;
  if (!restarted && newest_frame_ && frame.scene()->frame() < *newest_frame_) return;
  const SceneState scene = from_wire(*frame.scene());
  engine_epoch_ = frame.header()->epoch();
  const bool first = !newest_frame_;
  newest_frame_ = frame.scene()->frame();
  last_light_ = scene.light;

  auto objects_now = object_bytes(frame);
  if (first || objects_now != said_objects_) {
    said_objects_ = std::move(objects_now);
    publisher_.publish(topics::kSceneObjects, {.capture_ns = frame.header()->capture_ns()},
                       [&](flatbuffers::FlatBufferBuilder& builder, auto header) {
                         const auto objects = to_wire(builder, scene.objects);
                         return wire::CreateSceneObjects(builder, header, frame.scene()->frame(),
                                                         frame.scene()->time_s(), objects);
                       });
  }
  auto light_now = light_bytes(scene.light);
  if (first || light_now != said_light_) {
    said_light_ = std::move(light_now);
    publisher_.publish(topics::kSceneLight, {.capture_ns = frame.header()->capture_ns()},
                       [&](flatbuffers::FlatBufferBuilder& builder, auto header) {
                         const auto light = to_wire(builder, scene.light);
                         return wire::CreateSceneLight(builder, header, frame.scene()->frame(), frame.scene()->time_s(),
                                                       light);
                       });
  }
}

}  // namespace splatbus::capture_bridge

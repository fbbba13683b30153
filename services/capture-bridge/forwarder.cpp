#include "capture-bridge/forwarder.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>

#include "bus/clock.h"
#include "bus/frames.h"
#include "bus/log_sink.h"
#include "bus/memory.h"
#include "bus/trace.h"
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

/// A light as it came, to compare.
std::vector<std::uint8_t> light_bytes(const wire::Light& light) {
  std::vector<std::uint8_t> bytes;
  const auto append = [&bytes](const void* data, std::size_t size) {
    const auto* begin = static_cast<const std::uint8_t*>(data);
    bytes.insert(bytes.end(), begin, begin + size);
  };
  const std::uint64_t generation = light.generation();
  append(&generation, sizeof(generation));
  for (const wire::Vec3* vector : {light.sun_direction(), light.sun_irradiance(), light.background()}) {
    bytes.push_back(vector != nullptr ? 1 : 0);
    if (vector != nullptr) append(vector, sizeof(*vector));
  }
  if (const auto* ambient = light.ambient_sh()) append(ambient->data(), ambient->size() * sizeof(float));
  const std::uint64_t sun_depth_version = light.sun_depth_version();
  append(&sun_depth_version, sizeof(sun_depth_version));
  if (const auto* sources = light.sources(); sources != nullptr && sources->size() > 0) {
    append(sources->Get(0), sources->size() * sizeof(wire::LightSource));
  }
  return bytes;
}

/// An engine that does not say which depth maps show the same has others with every version; one that is started again
/// begins to count anew, while readers still have the maps of the one before.
void name_depths(SceneState& scene, std::uint64_t engine_epoch) {
  const auto named = [&](std::uint64_t depth_version) {
    return depth_version == 0 ? scene.version : depth_version + engine_epoch;
  };
  scene.light.sun_depth_version = named(scene.light.sun_depth_version);
  for (LightSource& source : scene.light.sources) source.depth_version = named(source.depth_version);
}

}  // namespace

// In nanoseconds since the machine started: a bridge that comes later counts on from a larger number.
Forwarder::Forwarder(const std::shared_ptr<bus::Context>& context, Device kind)
    : publisher_(context),
      kind_(kind),
      versions_(static_cast<std::uint64_t>(bus::now_ns())),
      shown_(versions_.newest()) {}

bool Forwarder::reference(const bus::Message& message, const wire::EngineFrame& frame) {
  bus::MessageInfo info{.capture_ns = frame.header()->capture_ns()};
  const bus::TracedWork work("forward reference", info.capture_ns, shown_.state->version);
  auto color = message.forward_tensor("color");
  if (!color) return false;
  info.tensors.push_back(std::move(*color));
  for (const char* name : {"albedo", "depth"}) {
    if (auto tensor = message.forward_tensor(name)) info.tensors.push_back(std::move(*tensor));
  }
  if (masks_objects_) {
    auto object_id = message.forward_tensor("object_id");
    if (!object_id) return false;
    info.tensors.push_back(std::move(*object_id));
  }
  const Camera camera = from_wire(*frame.camera());
  publisher_.publish(topics::kCaptureReference, info, [&](flatbuffers::FlatBufferBuilder& builder, auto header) {
    const auto scene_offset = to_wire(builder, *shown_.state, shown_.frame, shown_.time_s);
    const wire::Camera out = to_wire(camera);
    return wire::CreateCaptureReference(builder, header, &out, scene_offset, false);
  });
  return true;
}

void Forwarder::retire(const Camera& camera) {
  publisher_.publish(topics::kCaptureReference, [&](flatbuffers::FlatBufferBuilder& builder, auto header) {
    const auto scene = to_wire(builder, SceneState{.light = light(), .objects = {}});
    const wire::Camera out = to_wire(camera);
    return wire::CreateCaptureReference(builder, header, &out, scene, true);
  });
}

bool Forwarder::probe(const bus::Message& message, const wire::EngineFrame& frame, const Probe& probe) {
  auto color = message.forward_tensor("color");
  if (!color) return false;
  bus::MessageInfo info{.capture_ns = frame.header()->capture_ns()};
  info.tensors.push_back(std::move(*color));
  for (const char* name : {"object_id", "depth"}) {
    if (auto tensor = message.forward_tensor(name)) info.tensors.push_back(std::move(*tensor));
  }
  Camera camera = from_wire(*frame.camera());
  camera.id = probe.camera.id;
  publisher_.publish(topics::kCaptureProbe, info, [&](flatbuffers::FlatBufferBuilder& builder, auto header) {
    const auto scene_offset = to_wire(builder, *shown_.state, shown_.frame, shown_.time_s);
    const wire::Camera out = to_wire(camera);
    return wire::CreateCaptureProbe(builder, header, probe.probe_id, &out, scene_offset);
  });
  return true;
}

bool Forwarder::light_depth(const bus::Message& message, const wire::EngineFrame& frame, std::uint32_t light_maps,
                            std::atomic<std::uint64_t>& host_bytes) {
  const Camera camera = from_wire(*frame.camera());
  const bus::TracedWork work("forward light depth", frame.header()->capture_ns(), shown_.state->version);
  const auto depth = message.tensor("light_depth", bus::ElementType::F32, {camera.height, camera.width});
  if (!depth || !depth->still_valid()) return false;
  const bus::TensorSource source{
      "light_depth", {camera.height, camera.width}, bus::ElementType::F32, depth->data(), depth->memory()};
  const std::pair<std::uint32_t, std::uint32_t> key(frame.light_id(), frame.light_map());
  bus::TensorRing& ring =
      light_depth_rings_
          .try_emplace(key, publisher_.context(), fmt::format("light_depth-{}-{}", key.first, key.second),
                       kLightDepthSlots, 0, kind_)
          .first->second;
  const bus::MessageInfo info{.capture_ns = frame.header()->capture_ns(),
                              .latch_key = fmt::format("{}/{}", key.first, key.second),
                              .tensors = ring.write(std::span(&source, 1))};
  if (kind_ == Device::Cpu || depth->memory() == Device::Cpu) host_bytes += depth->bytes();
  if (!depth->still_valid()) return false;
  publisher_.publish(topics::kSceneLightDepth, info, [&](flatbuffers::FlatBufferBuilder& builder, auto header) {
    const auto scene_offset = to_wire(builder, *shown_.state, shown_.frame, shown_.time_s);
    const wire::Camera out = to_wire(camera);
    return wire::CreateSceneLightDepth(builder, header, &out, scene_offset, key.first,
                                       static_cast<std::uint8_t>(key.second), static_cast<std::uint8_t>(light_maps));
  });
  return true;
}

bool Forwarder::scene(const wire::EngineFrame& frame, bool with_far_field) {
  const wire::SceneState& scene = *frame.scene();
  const bool restarted = frame.header()->epoch() != engine_epoch_;
  auto objects_now = object_bytes(frame);
  auto light_now = light_bytes(*scene.light());
  const bool unchanged = !restarted && newest_frame_ && objects_now == said_objects_ && light_now == said_light_ &&
                         with_far_field == said_far_field_;
  if (!restarted && newest_frame_ && scene.frame() < *newest_frame_) {
    static bus::LogLimiter limiter;
    if (!unchanged && limiter.allow()) {
      spdlog::warn("engine/frame from {}: frame {} runs backwards, the newest is {}",
                   bus::printable(frame.header()->source()->string_view()), scene.frame(), *newest_frame_);
    }
    if (unchanged) show(versions_.newest(), scene.frame(), scene.time_s());
    return unchanged;
  }
  if (!unchanged) {
    SceneState now = from_wire(scene);  // may throw, and then nothing is said or kept
    if (with_far_field) now.objects.insert_or_assign(kFarFieldFrame, far_field());
    now.version = newest_version() + 1;
    name_depths(now, frame.header()->epoch());
    versions_.add(std::move(now));
    std::erase_if(light_depth_rings_, [&](const auto& ring) {
      return ring.first.first != 0 && std::ranges::none_of(light().sources, [&](const LightSource& source) {
               return source.id == ring.first.first;
             });
    });
    said_objects_ = std::move(objects_now);
    said_light_ = std::move(light_now);
    said_far_field_ = with_far_field;
  }
  engine_epoch_ = frame.header()->epoch();
  newest_frame_ = scene.frame();
  versions_.seen(scene.frame(), scene.time_s());
  show(versions_.newest(), scene.frame(), scene.time_s());
  if (unchanged) return true;
  const bus::MessageInfo info{.capture_ns = frame.header()->capture_ns()};
  const bus::TracedWork work("publish scene", info.capture_ns, newest_version());
  publisher_.publish(topics::kSceneState, info, [&](flatbuffers::FlatBufferBuilder& builder, auto header) {
    return wire::CreateSceneUpdate(builder, header, to_wire(builder, *shown_.state, scene.frame(), scene.time_s()));
  });
  return true;
}

bool Forwarder::follow(const SceneState& scene) {
  const SceneVersion* const version = versions_.showing(scene);
  if (version != nullptr) show(*version, version->frame, version->time_s);
  return version != nullptr;
}

void Forwarder::show(const SceneVersion& version, std::uint64_t frame, double time_s) {
  if (version.state != shown_.state) {
    masks_objects_ =
        std::ranges::any_of(version.state->objects, [](const auto& object) { return !object.second.modelled; });
  }
  shown_ = {.state = version.state, .frame = frame, .time_s = time_s};
}

}  // namespace splatbus::capture_bridge

#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <set>
#include <span>
#include <string_view>
#include <utility>
#include <vector>

#include "analytic_scene.h"
#include "bus/publisher.h"
#include "bus/subscriber.h"
#include "bus/tensor_ring.h"
#include "wire/convert.h"
#include "wire/engine_generated.h"

namespace splatbus::capture_bridge::test {

/// An engine on the bus that renders the analytic scene, one frame for each new request id; asked by name or not.
class FakeEngine {
 public:
  /// Its pictures lie in memory of `kind`.
  explicit FakeEngine(const std::shared_ptr<bus::Context>& context, Device kind = Device::Cpu)
      : subscriber_(context, {"engine/cameras"}), publisher_(context), ring_(context, "frames", 512, 0, kind) {}

  /// Takes in the newest camera set and renders what is new in it.
  void serve() {
    while (auto message = subscriber_.receive(std::chrono::milliseconds(0))) {
      const auto* key = message->header().latch_key();
      const std::string_view name = key == nullptr ? std::string_view() : key->string_view();
      if (name.empty() ? named_ : name != publisher_.context()->source()) continue;
      named_ = !name.empty();
      requests_.clear();
      for (const wire::CameraRequest* request : *message->root<wire::EngineCameras>().cameras()) {
        requests_.push_back({from_wire(*request->camera()), request->buffers(), request->request_id(),
                             request->light_id(), request->light_map(), request->extent_m()});
      }
    }
    for (const Request& request : requests_) {
      if (!answered_.insert(request.id).second || (lose && lose(request.camera))) continue;
      if (request.camera.role == CameraRole::Light) {
        submit_light(request);
      } else {
        submit(request.camera, request.buffers, request.id);
      }
    }
  }

  void submit(const Camera& camera, wire::EngineBuffer buffers, std::uint64_t request_id, std::uint32_t light_id = 0,
              std::uint32_t light_map = 0) {
    const InputView view = camera.role == CameraRole::Light ? InputView{} : scene.render(camera);
    if (relabel) relabel(view);
    const std::vector<float> light_depth(std::size_t{camera.width} * camera.height, 7.0F);
    const auto has = [&](wire::EngineBuffer buffer) { return (buffers & buffer) != wire::EngineBuffer::NONE; };
    std::vector<bus::TensorSource> sources;
    const auto add = [&](const char* name, bus::ElementType type, const void* data) {
      sources.push_back({name, {camera.height, camera.width, 4}, type, data});
    };
    std::vector<glm::vec4> position(view.position.begin(), view.position.end());
    if (spoil) spoil(position);
    std::vector<float> depth;
    for (std::size_t i = 0; i < view.position.size(); ++i) {
      depth.push_back(view.object_id[i] == 0 ? 0 : project(camera, glm::vec3(view.position[i])).z);
    }
    if (has(wire::EngineBuffer::Color)) add("color", bus::ElementType::U8, view.color.data());
    if (has(wire::EngineBuffer::Albedo)) add("albedo", bus::ElementType::U8, view.albedo.data());
    if (has(wire::EngineBuffer::WorldPosition)) add("world_position", bus::ElementType::F32, position.data());
    if (has(wire::EngineBuffer::Normal)) add("normal", bus::ElementType::F32, view.normal.data());
    if (has(wire::EngineBuffer::ObjectId)) {
      sources.push_back({"object_id", {camera.height, camera.width}, bus::ElementType::U32, view.object_id.data()});
    }
    if (has(wire::EngineBuffer::Depth)) {
      sources.push_back({"depth", {camera.height, camera.width}, bus::ElementType::F32, depth.data()});
    }
    if (has(wire::EngineBuffer::LightDepth)) {
      sources.push_back({"light_depth", {camera.height, camera.width}, bus::ElementType::F32, light_depth.data()});
    }
    ++frame;
    std::vector<bus::OutgoingTensor> tensors = ring_.write(sources);
    if (claimed_rows > 1) {
      std::vector<bus::OutgoingTensor> lies = tensors;
      for (bus::OutgoingTensor& lie : lies) {
        const wire::Span& there = lie.span;
        lie.shape[0] *= claimed_rows;
        lie.span =
            wire::Span(there.slab(), there.generation(), there.offset(), there.bytes() * claimed_rows, there.storage());
      }
      Camera tall = camera;
      tall.height *= claimed_rows;
      publish(tall, request_id, std::move(lies), light_id, light_map);
    }
    publish(camera, request_id, std::move(tensors), light_id, light_map);
    ++submitted[camera.role];
  }

  struct Request {
    Camera camera;
    wire::EngineBuffer buffers;
    std::uint64_t id;
    std::uint32_t light_id = 0, light_map = 0;
    float extent_m = 0;
  };

  /// By the light's own camera: cascades look along it, those of the whole scene over scene_m, faces from it.
  /// Objects and light alone.
  void submit_scene() { publish({}, 0, {}, 0, 0); }

  void submit_light(const Request& request) {
    Camera camera = request.camera;
    const auto source =
        std::ranges::find_if(light.sources, [&](const LightSource& one) { return one.id == request.light_id; });
    const bool known = source != light.sources.end();
    if (!known || source->kind == LightKind::Directional) {
      const glm::vec3 to_light = known ? source->direction : light.sun_direction;
      camera.world_from_camera = look_at(20.0F * to_light, {0, 0, 0}, 1, 1, 1).world_from_camera;
      camera.fx = camera.fy = static_cast<float>(camera.width) / (request.extent_m > 0 ? request.extent_m : scene_m);
    } else {
      camera.world_from_camera.translation = source->position;
      camera.fx = camera.fy = static_cast<float>(camera.width) / 2;
      camera.near_m = 0.1F;
    }
    if (turn_light_camera) turn_light_camera(camera);
    ++light_maps_drawn;
    submit(camera, request.buffers, request.id, request.light_id, request.light_map);
  }

  [[nodiscard]] const std::vector<Request>& requests() const { return requests_; }
  [[nodiscard]] std::size_t requested(CameraRole role) const {
    return static_cast<std::size_t>(std::count_if(requests_.begin(), requests_.end(),
                                                  [&](const Request& request) { return request.camera.role == role; }));
  }
  bus::Publisher& publisher() { return publisher_; }
  [[nodiscard]] std::uint64_t epoch() const { return publisher_.context()->epoch(); }

  AnalyticScene scene;
  ObjectTransforms objects;
  Light light{.generation = 1, .sun_irradiance = {1, 1, 1}};
  std::uint64_t light_maps_drawn = 0;  ///< one that is late is asked for again
  std::uint64_t frame = 0;
  float scene_m = 12;                                  ///< side of what depth maps of the whole scene show
  std::function<void(Camera&)> turn_light_camera;      ///< changes light cameras before they go out
  std::function<bool(const Camera&)> lose;             ///< true: this camera's frame never comes
  std::function<void(std::vector<glm::vec4>&)> spoil;  ///< changes positions before they go out
  std::function<void(const InputView&)> relabel;       ///< changes who shows where
  std::uint32_t claimed_rows = 1;  ///< more: before each frame comes one that says to have so many times the rows
  std::map<CameraRole, int> submitted;

 private:
  void publish(const Camera& camera, std::uint64_t request_id, std::vector<bus::OutgoingTensor> tensors,
               std::uint32_t light_id, std::uint32_t light_map) {
    const bus::MessageInfo info{.capture_ns = 1234, .tensors = std::move(tensors)};
    publisher_.publish(topics::kEngineFrame, info, [&](flatbuffers::FlatBufferBuilder& builder, auto header) {
      const auto objects_offset = to_wire(builder, objects);
      const auto light_offset = to_wire(builder, light);
      const wire::Camera out = to_wire(camera);
      const auto scene_offset =
          wire::CreateSceneState(builder, frame, 0.1 * static_cast<double>(frame), objects_offset, light_offset);
      return wire::CreateEngineFrame(builder, header, request_id, &out, scene_offset, light_id,
                                     static_cast<std::uint8_t>(light_map));
    });
  }

  bus::Subscriber subscriber_;
  bus::Publisher publisher_;
  bus::TensorRing ring_;
  std::vector<Request> requests_;
  bool named_ = false;  // its bridge has asked it by name
  std::set<std::uint64_t> answered_;
};

}  // namespace splatbus::capture_bridge::test

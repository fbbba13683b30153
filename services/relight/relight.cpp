#include "relight/relight.h"

#include <spdlog/spdlog.h>

#include <chrono>
#include <span>
#include <utility>

#include "bus/memory.h"
#include "bus/parameters.h"
#include "model/published_model.h"
#include "wire/convert.h"
#include "wire/model_generated.h"
#include "wire/scene_generated.h"

namespace splatbus::relight {

namespace {

using namespace std::chrono_literals;

constexpr auto kReceiveTimeout = 50ms;
constexpr std::size_t kRingSlots = 4;
constexpr std::uint32_t kMaxSide = 16384;

/// Whether a map through b shows what one through a shows: the planes only say how far it reaches.
bool same_projection(const Camera& a, const Camera& b) {
  return a.width == b.width && a.height == b.height && a.fx == b.fx && a.fy == b.fy && a.cx == b.cx && a.cy == b.cy &&
         a.world_from_camera == b.world_from_camera;
}

}  // namespace

void VisibilityOptions::bind(bus::ParameterBinder& p) {
  p.add("softness_m", softness_m, "radius in metres of the shadow's filter, as the engine's own", {0, 10});
  p.add("footprint", footprint, "added to that radius, in standard deviations of the Gaussian", {0, 10});
  p.add("lift_texels", lift_texels, "by which a tested point is raised along its normal, in texels of the depth map",
        {0, 100});
}

float* Relight::Memory::floats(std::size_t count, Device kind) {
  const std::size_t needed = count * sizeof(float);
  if (size < needed || !bytes) {
    bytes = bus::allocate_memory(kind, needed);
    size = needed;
  }
  return reinterpret_cast<float*>(bytes.get());
}

Relight::Relight(bus::ServiceContext& service)
    : service_(service),
      memory_(service.backend),
      stream_(service.backend),
      publisher_(service.bus),
      ring_(service.bus, "visibility", kRingSlots, 0, memory_),
      options_(service.parameters) {}

void Relight::run() {
  bus::Subscriber subscriber(service_.bus);
  subscriber
      .on(topics::kModelPublished,
          [this](const wire::ModelPublished&, const bus::Message& message) { model_ = message; })
      .on(topics::kSceneLightDepth,
          [this](const wire::SceneLightDepth& depth, const bus::Message& message) { take_depth(depth, message); })
      .on(topics::kSceneObjects, [this](const wire::SceneObjects& body, const bus::Message&) { take_objects(body); });
  while (!service_.stop.stop_requested()) {
    const std::uint64_t refused = subscriber.refused();
    subscriber.dispatch_newest(kReceiveTimeout);
    if (subscriber.refused() != refused) bus::require_usable(memory_);
    // A model that makes no sense is reported once.
    if (model_ && !bus::guarded(*model_, [&] { update(); })) {
      bus::require_usable(memory_);
      model_.reset();
    }
    report();
  }
}

void Relight::report() {
  service_.counter("lost_tensors", static_cast<double>(lost_tensors_));
  service_.counter("published", static_cast<double>(published_));
  service_.counter("host_copied_bytes", static_cast<double>(host_copied_bytes_.load()));
  service_.detail(!map_ ? "waits for scene/light_depth" : !model_ ? "waits for model/published" : "follows the light");
}

void Relight::take_objects(const wire::SceneObjects& body) {
  auto objects = from_wire(body.objects());
  // With transforms of its own, the depth map is what the visibility follows: both are of one frame.
  scene_changed_ |= map_ && map_->objects.empty() && (objects_ != objects);
  objects_ = std::move(objects);
}

void Relight::take_depth(const wire::SceneLightDepth& depth, const bus::Message& message) {
  DepthMap map{.camera = from_wire(*depth.camera()),
               .light_generation = depth.scene()->light()->generation(),
               .objects = from_wire(depth.scene()->objects()),
               .depth_m = {}};
  if (map.camera.role != CameraRole::Light || map.camera.width > kMaxSide || map.camera.height > kMaxSide) {
    throw bus::Error(message.topic() + ": its camera is no light camera of at most " + std::to_string(kMaxSide) +
                     " texels a side");
  }
  const bool unchanged = map_ && map_->light_generation == map.light_generation &&
                         same_projection(map_->camera, map.camera) && map_->objects == map.objects;
  if (unchanged) return;
  const auto tensor = message.tensor("light_depth", bus::ElementType::F32, {map.camera.height, map.camera.width});
  // The map that is in use stays whole until the new one is.
  if (!tensor ||
      !bus::copy_tensor(*tensor, spare_depth_.floats(tensor->elements(), memory_), memory_, host_copied_bytes_)) {
    ++lost_tensors_;
    return;
  }
  std::swap(map.depth_m, spare_depth_);
  if (map_) std::swap(map_->depth_m, spare_depth_);
  map_ = std::move(map);
  scene_changed_ = true;
}

void Relight::update() {
  if (!map_) return;
  const auto& published = model_->root<wire::ModelPublished>();
  scene_changed_ |= options_.refresh();
  if (!scene_changed_ && published.generation() == computed_generation_) return;
  if (published.count() == 0) return;
  const auto model = PublishedModel::open(*model_, memory_, PublishedModel::Need::Average);
  if (!model) {
    model_.reset();  // its structure has moved on: the next message is on its way
    return;
  }
  const auto start = std::chrono::steady_clock::now();
  const GaussiansView& gaussians = model->average();
  float* const visibility = visibility_.floats(gaussians.count, memory_);
  const ObjectTransforms& objects = map_->objects.empty() && objects_ ? *objects_ : map_->objects;
  const auto* const depth_m = reinterpret_cast<const float*>(map_->depth_m.bytes.get());
  compute_visibility(stream_, gaussians, objects, {.camera = map_->camera, .depth_m = depth_m}, *options_, visibility);
  host_copied_bytes_ += model->copied_bytes();
  if (!model->still_valid()) {
    model_.reset();
    return;
  }
  const std::chrono::duration<double, std::milli> spent = std::chrono::steady_clock::now() - start;
  service_.counter("compute_ms", spent.count());
  computed_generation_ = model->generation();
  scene_changed_ = false;
  publish(model->generation(), gaussians.count, visibility);
}

void Relight::publish(std::uint64_t model_generation, std::size_t count, const float* visibility) {
  const bus::TensorSource source{
      .name = "visibility", .shape = {1, static_cast<std::uint32_t>(count)}, .data = visibility, .memory = memory_};
  publisher_.publish(
      topics::kRelightVisibility, {.tensors = ring_.write(std::span(&source, 1))}, [&](auto& builder, auto header) {
        return wire::CreateRelightVisibility(builder, header, model_generation, map_->light_generation, count);
      });
  ++published_;
}

}  // namespace splatbus::relight

#include "relight/relight.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <chrono>
#include <iterator>
#include <span>
#include <utility>

#include "bus/clock.h"
#include "bus/memory.h"
#include "bus/parameters.h"
#include "wire/capture_generated.h"
#include "wire/convert.h"
#include "wire/model_generated.h"
#include "wire/scene_generated.h"

namespace splatbus::relight {

namespace {

using namespace std::chrono_literals;

/// Whether a map through b shows what one through a shows: the planes only say how far it reaches.
bool same_projection(const Camera& a, const Camera& b) {
  return a.width == b.width && a.height == b.height && a.fx == b.fx && a.fy == b.fy && a.cx == b.cx && a.cy == b.cy &&
         a.world_from_camera == b.world_from_camera;
}

constexpr auto kReceiveTimeout = 50ms;
constexpr std::size_t kRingSlots = 8;
constexpr std::uint32_t kMaxSide = 16384;
constexpr std::size_t kMaxMaps = 8;        // pictures of a version come within a frame or two of its map
constexpr std::size_t kMaxPictured = 256;  // versions whose map has not come

}  // namespace

void VisibilityOptions::bind(bus::ParameterBinder& p) {
  p.add("softness_m", softness_m, "radius in metres of the shadow's filter, as the engine's own", {0, 10});
  p.add("footprint", footprint, "added to that radius, in standard deviations of the Gaussian", {0, 10});
  p.add("lift_texels", lift_texels, "by which a tested point is raised along its normal, in texels of the depth map",
        {0, 100});
}

void RelightOptions::bind(bus::ParameterBinder& p) {
  visibility.bind(p);
  p.add("newest_rate_hz", newest_rate_hz,
        "rate at which visibility of the newest scene is computed where no training picture is of it, Hz", {0.1, 1000});
}

Relight::Relight(bus::ServiceContext& service)
    : service_(service),
      memory_(service.backend),
      stream_(service.backend),
      publisher_(service.bus),
      ring_(service.bus, "visibility", kRingSlots, 0, memory_),
      depths_(memory_),
      options_(service.parameters),
      visibility_(stream_) {}

void Relight::run() {
  bus::Subscriber subscriber(service_.bus);
  subscriber
      .on(topics::kModelPublished,
          [this](const wire::ModelPublished&, const bus::Message& message) { model_ = message; })
      .on(topics::kSceneLightDepth,
          [this](const wire::SceneLightDepth& depth, const bus::Message& message) { take_depth(depth, message); })
      .on(topics::kCaptureReference, [this](const wire::CaptureReference& picture, const bus::Message&) {
        if (!picture.retire()) take_picture(picture.scene()->version());
      });
  while (!service_.stop.stop_requested()) {
    const std::uint64_t refused = subscriber.refused();
    subscriber.dispatch_all(kReceiveTimeout);
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
  service_.counter("unmapped_versions", static_cast<double>(unmapped_));
  service_.counter("host_copied_bytes", static_cast<double>(host_copied_bytes_.load()));
  service_.detail(maps_.empty() ? "waits for scene/light_depth"
                  : !model_     ? "waits for model/published"
                                : "follows the light");
}

void Relight::take_picture(std::uint64_t scene_version) {
  const auto map = std::find_if(maps_.begin(), maps_.end(),
                                [&](const DepthMap& candidate) { return candidate.scene.version == scene_version; });
  if (map != maps_.end()) {
    map->pictured = true;
    return;
  }
  if (!maps_.empty() && scene_version < maps_.front().scene.version) {
    ++unmapped_;  // its map has gone already
    return;
  }
  pictured_ahead_.insert(scene_version);
  if (pictured_ahead_.size() > kMaxPictured) {
    pictured_ahead_.erase(pictured_ahead_.begin());
    ++unmapped_;
  }
}

void Relight::take_depth(const wire::SceneLightDepth& depth, const bus::Message& message) {
  DepthMap map{.camera = from_wire(*depth.camera()),
               .scene = from_wire(*depth.scene()),
               .depth_m = nullptr,
               .computed_generation = std::nullopt};
  if (map.camera.role != CameraRole::Light || map.camera.width > kMaxSide || map.camera.height > kMaxSide) {
    throw bus::Error(message.topic() + ": its camera is no light camera of at most " + std::to_string(kMaxSide) +
                     " texels a side");
  }
  // A map that runs behind changes nothing, nor does one that comes again, unless it is another, of another size say.
  const bool again = !maps_.empty() && map.scene.version == maps_.back().scene.version;
  if (again && same_projection(map.camera, maps_.back().camera)) return;
  if (!maps_.empty() && map.scene.version < maps_.back().scene.version) return;
  const auto tensor = message.tensor("light_depth", bus::ElementType::F32, {map.camera.height, map.camera.width});
  if (tensor) map.depth_m = depths_.take(tensor->bytes());
  if (!tensor || !bus::copy_tensor(*tensor, map.depth_m.get(), memory_, host_copied_bytes_)) {
    ++lost_tensors_;
    return;
  }
  map.pictured = pictured_ahead_.erase(map.scene.version) > 0 || (again && maps_.back().pictured);
  if (again) maps_.pop_back();
  const auto passed = pictured_ahead_.lower_bound(map.scene.version);
  unmapped_ += static_cast<std::uint64_t>(std::distance(pictured_ahead_.begin(), passed));
  pictured_ahead_.erase(pictured_ahead_.begin(), passed);
  maps_.push_back(std::move(map));
  if (maps_.size() > kMaxMaps) maps_.pop_front();
}

bool Relight::is_due(const DepthMap& map, std::int64_t now_ns) const {
  const auto& published = model_->root<wire::ModelPublished>();
  if (map.computed_generation == published.generation()) return false;
  if (map.pictured) return true;
  if (&map != &maps_.back()) return false;
  // Of a model whose structure has changed nobody has the visibility yet.
  if (map.computed_generation) return true;
  const auto period_ns = static_cast<std::int64_t>(1e9 / options_->newest_rate_hz);
  return now_ns - newest_computed_ns_ >= period_ns;
}

void Relight::update() {
  if (options_.refresh()) {
    for (DepthMap& map : maps_) map.computed_generation.reset();
  }
  if (model_->root<wire::ModelPublished>().count() == 0) return;
  const std::int64_t now_ns = bus::now_ns();
  std::optional<PublishedModel> model;
  // The newest first: viewers and most pictures wait for it.
  for (auto map = maps_.rbegin(); map != maps_.rend(); ++map) {
    if (!is_due(*map, now_ns)) continue;
    if (!model) model = PublishedModel::open(*model_, memory_, PublishedModel::Need::Average);
    if (!model || !compute(*map, *model)) {
      model_.reset();  // its structure has moved on: the next message is on its way
      return;
    }
    if (map == maps_.rbegin()) newest_computed_ns_ = now_ns;
  }
}

bool Relight::compute(DepthMap& map, const PublishedModel& model) {
  const auto start = std::chrono::steady_clock::now();
  const GaussiansView& gaussians = model.average();
  visibility_.resize(gaussians.count);
  compute_visibility(stream_, gaussians, map.scene.objects,
                     {.camera = map.camera, .depth_m = reinterpret_cast<const float*>(map.depth_m.get())},
                     options_->visibility, visibility_.data());
  host_copied_bytes_ += model.copied_bytes();
  if (!model.still_valid()) return false;
  const std::chrono::duration<double, std::milli> spent = std::chrono::steady_clock::now() - start;
  service_.counter("compute_ms", spent.count());
  map.computed_generation = model.generation();
  publish(model.generation(), map.scene.version, gaussians.count, visibility_.data());
  return true;
}

void Relight::publish(std::uint64_t model_generation, std::uint64_t scene_version, std::size_t count,
                      const std::uint8_t* visibility) {
  const bus::TensorSource source{.name = "visibility",
                                 .shape = {1, static_cast<std::uint32_t>(count)},
                                 .type = bus::ElementType::U8,
                                 .data = visibility,
                                 .memory = memory_};
  publisher_.publish(topics::kRelightVisibility, {.tensors = ring_.write(std::span(&source, 1))},
                     [&](auto& builder, auto header) {
                       const std::uint32_t sun = 0;
                       return wire::CreateRelightVisibility(builder, header, model_generation, scene_version, count,
                                                            builder.CreateVector(&sun, 1));
                     });
  ++published_;
}

}  // namespace splatbus::relight

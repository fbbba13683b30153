#include "relight/relight.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <chrono>
#include <iterator>
#include <span>
#include <string>
#include <utility>

#include "bus/clock.h"
#include "bus/memory.h"
#include "bus/parameters.h"
#include "bus/trace.h"
#include "wire/capture_generated.h"
#include "wire/convert.h"
#include "wire/model_generated.h"
#include "wire/scene_generated.h"
#include "wire/system_generated.h"

namespace splatbus::relight {

namespace {

using namespace std::chrono_literals;

constexpr auto kReceiveTimeout = 50ms;
constexpr std::size_t kRingSlots = 8;
constexpr std::int64_t kAloneNs = 2'000'000'000;  // without a word of who else is there, until it computes everything
constexpr std::size_t kMaxReady = 8;              // versions that are kept for a model whose structure changes
constexpr std::size_t kMaxWaiting = 256;          // versions whose maps have not come

bool has_light(const Light& light, std::uint32_t id) {
  return id == 0 || std::ranges::count(light.sources, id, &LightSource::id) > 0;
}

}  // namespace

void VisibilityOptions::bind(bus::ParameterBinder& p) {
  p.add("softness_m", softness_m, "radius of the shadow filter, as in the engine, m", {0, 10});
  p.add("footprint", footprint, "addition to the filter radius, in standard deviations of the Gaussian", {0, 10});
  p.add("lift_texels", lift_texels, "height above the surface at which a point is tested, in texels of the depth map",
        {0, 100});
}

void RelightOptions::bind(bus::ParameterBinder& p) {
  visibility.bind(p);
  p.add("newest_rate_hz", newest_rate_hz,
        "rate of visibility for the newest scene when no training picture shows it, Hz", {0.1, 1000});
}

Relight::Relight(bus::ServiceContext& service)
    : service_(service),
      memory_(service.backend),
      stream_(service.backend),
      publisher_(service.bus),
      ring_(service.bus, "visibility", kRingSlots, 0, memory_),
      depths_(memory_),
      options_(service.parameters),
      shares_(service.bus->source()),
      begin_ns_(bus::now_ns()),
      rows_(stream_) {}

void Relight::run() {
  bus::Subscriber subscriber(service_.bus);
  subscriber.on(topics::kModelPublished, [this](const wire::ModelPublished&, const bus::Message& m) { take_model(m); })
      .on(topics::kSceneState,
          [this](const wire::SceneUpdate& update, const bus::Message&) { take_scene(*update.scene(), false); })
      .on(topics::kSceneLightDepth,
          [this](const wire::SceneLightDepth& depth, const bus::Message& message) { take_depth(depth, message); })
      .on(topics::kLiveness,
          [this](const wire::Liveness& liveness, const bus::Message&) {
            if (!shares_.take(liveness)) return;
            spdlog::info("one of {} that share the pages", shares_.sources().size());
            for (auto& [number, version] : versions_) version.computed_generation.reset();
          })
      .on(topics::kCaptureReference, [this](const wire::CaptureReference& picture, const bus::Message&) {
        if (!picture.retire()) take_scene(*picture.scene(), true);
      });
  while (!service_.stop.stop_requested()) {
    const std::uint64_t refused = subscriber.refused();
    subscriber.dispatch_all(kReceiveTimeout);
    if (subscriber.refused() != refused) bus::require_usable(memory_);
    resolve();
    // A model that makes no sense is reported once.
    if (model_ && !bus::guarded(*model_, [&] { update(); })) {
      bus::require_usable(memory_);
      model_.reset();
      rows_.forget();  // which may be half done
    }
    report();
  }
}

void Relight::report() {
  service_.counter("lost_tensors", static_cast<double>(lost_tensors_));
  service_.counter("published", static_cast<double>(published_));
  service_.counter("unmapped_versions", static_cast<double>(unmapped_));
  service_.counter("pages_computed", static_cast<double>(rows_.computed()));
  service_.counter("pages_skipped", static_cast<double>(rows_.skipped()));
  service_.counter("host_copied_bytes", static_cast<double>(host_copied_bytes_.load()));
  service_.detail(newest() == versions_.end() ? "waits for scene/light_depth"
                  : !model_                   ? "waits for model/published"
                                              : "follows the light");
}

void Relight::take_model(const bus::Message& message) {
  if (message.header().epoch() != model_epoch_) rows_.forget();
  model_epoch_ = message.header().epoch();
  model_ = message;
}

void Relight::take_scene(const wire::SceneState& scene, bool pictured) {
  const auto known = versions_.find(scene.version());
  if (known != versions_.end()) {
    known->second.pictured |= pictured;
    return;
  }
  if (!pictured && !versions_.empty() && scene.version() < versions_.rbegin()->first) return;
  Version version{.scene = from_wire(scene), .pictured = pictured, .lights = {}, .computed_generation = std::nullopt};
  if (versions_.empty() || scene.version() > versions_.rbegin()->first) maps_.keep(version.scene.light);
  const auto added = versions_.emplace(scene.version(), std::move(version)).first;
  if (is_hopeless(added->second)) drop(added);
}

void Relight::take_depth(const wire::SceneLightDepth& depth, const bus::Message& message) {
  const Camera camera = from_wire(*depth.camera());
  if (camera.role != CameraRole::Light) {
    throw bus::Error(message.topic() + ": its camera is not a light camera");
  }
  const MapRing::Key key = MapRing::key_of(depth);
  take_scene(*depth.scene(), false);
  if (maps_.holds(key, camera)) return;
  const auto tensor = message.tensor("light_depth", bus::ElementType::F32, {camera.height, camera.width});
  auto values = tensor ? depths_.take(tensor->bytes()) : nullptr;
  if (!tensor || !bus::copy_tensor(*tensor, values.get(), memory_, host_copied_bytes_)) {
    ++lost_tensors_;
    return;
  }
  maps_.put(key, {.camera = camera, .depth_m = std::move(values)}, depth.scene()->version());
}

bool Relight::find_maps(Version& version) const {
  auto lights = find_lights(version.scene.light, maps_);
  if (!lights) return !version.lights.empty();  // with those that it has had
  const bool same = std::ranges::equal(*lights, version.lights, {}, &LightOfScene::maps, &LightOfScene::maps);
  if (!same) version.computed_generation.reset();
  version.lights = std::move(*lights);
  return true;
}

bool Relight::is_hopeless(const Version& version) const {
  const bool newest = versions_.empty() || version.scene.version >= versions_.rbegin()->first;
  const auto is_past = [&](const LightSource& source) {
    if (!source.casts_shadow || maps_.find(source.id, source.depth_version)) return false;
    // A light that has gone meanwhile took its maps with it.
    return maps_.is_past(source.id, version.scene.version) ||
           (!newest && !maps_.knows(source.id) && !has_light(versions_.rbegin()->second.scene.light, source.id));
  };
  return version.lights.empty() &&
         (is_past(sun_source(version.scene.light)) || std::ranges::any_of(version.scene.light.sources, is_past));
}

void Relight::drop(Versions::iterator version) {
  if (version->second.pictured && !version->second.computed_generation) ++unmapped_;
  versions_.erase(version);
}

Relight::Versions::iterator Relight::newest() {
  auto found = versions_.end();
  while (found != versions_.begin()) {
    if (!(--found)->second.lights.empty()) return found;
  }
  return versions_.end();
}

void Relight::resolve() {
  std::size_t ready = 0;
  for (auto& [number, version] : versions_) ready += find_maps(version) ? 1 : 0;
  const auto newest_ready = newest();
  std::size_t waiting = versions_.size() - ready;
  for (auto version = versions_.begin(); version != versions_.end();) {
    const auto next = std::next(version);
    const bool is_ready = !version->second.lights.empty();
    const bool superseded =
        newest_ready != versions_.end() && version->first < newest_ready->first && !version->second.pictured;
    const bool too_many = is_ready ? ready > kMaxReady : waiting > kMaxWaiting;
    if (superseded || too_many || is_hopeless(version->second)) {
      --(is_ready ? ready : waiting);
      drop(version);
    }
    version = next;
  }
}

bool Relight::is_due(const Version& version, std::int64_t now_ns) {
  const auto& published = model_->root<wire::ModelPublished>();
  if (version.lights.empty() || version.computed_generation == published.generation()) return false;
  if (version.pictured) return true;
  // Of a model whose structure has changed nobody has the visibility yet.
  if (version.computed_generation) return true;
  const auto period_ns = static_cast<std::int64_t>(1e9 / options_->newest_rate_hz);
  return now_ns - newest_computed_ns_ >= period_ns;
}

void Relight::update() {
  if (options_.refresh()) {
    for (auto& [number, version] : versions_) version.computed_generation.reset();
  }
  if (model_->root<wire::ModelPublished>().count() == 0) return;
  const std::int64_t now_ns = bus::now_ns();
  if (!shares_.heard() && now_ns - begin_ns_ < kAloneNs) return;
  const auto newest_ready = newest();
  std::optional<PublishedModel> model;
  // The newest first: viewers and most pictures wait for it.
  for (auto at = versions_.end(); at != versions_.begin();) {
    auto& [number, version] = *--at;
    if (!is_due(version, now_ns)) continue;
    if (!model) model = PublishedModel::open(*model_, memory_, PublishedModel::Need::Average);
    if (!model || !compute(version, *model)) {
      model_.reset();  // its structure has moved on: the next message is on its way
      return;
    }
    if (number == newest_ready->first) newest_computed_ns_ = now_ns;
  }
}

bool Relight::compute(Version& version, const PublishedModel& model) {
  const bus::TracedWork work("compute visibility", 0, version.scene.version);
  const auto start = std::chrono::steady_clock::now();
  GaussiansView gaussians = model.average();
  std::vector<IndexRange> ranges;
  std::vector<std::uint64_t> generations;
  for (std::size_t k = 0; k < gaussians.ranges.size(); ++k) {
    if (!shares_.owns(gaussians.ranges[k].first >> gaussians.page_shift)) continue;
    ranges.push_back(gaussians.ranges[k]);
    generations.push_back(model.page_generations()[k]);
  }
  gaussians.ranges = ranges;
  const std::uint8_t* const visibility =
      rows_.compute({.gaussians = gaussians, .page_generations = generations, .step = model.step()},
                    version.scene.objects, version.lights, options_->visibility);
  host_copied_bytes_ += model.copied_bytes();
  if (!model.still_valid()) {
    rows_.forget();
    return false;
  }
  const std::chrono::duration<double, std::milli> spent = std::chrono::steady_clock::now() - start;
  service_.counter("compute_ms", spent.count());
  version.computed_generation = model.generation();
  publish(model.generation(), version.scene, gaussians, visibility);
  return true;
}

void Relight::publish(std::uint64_t model_generation, const SceneState& scene, const GaussiansView& mine,
                      const std::uint8_t* visibility) {
  const std::size_t count = mine.count;
  const std::vector<std::uint32_t> ids = light_ids(scene.light);
  const bus::TensorSource source{.name = "visibility",
                                 .shape = {static_cast<std::uint32_t>(ids.size()), static_cast<std::uint32_t>(count)},
                                 .type = bus::ElementType::U8,
                                 .data = visibility,
                                 .memory = memory_};
  std::vector<std::uint32_t> pages;
  if (!shares_.alone()) {
    for (const IndexRange& range : mine.ranges) pages.push_back(range.first >> mine.page_shift);
  }
  publisher_.publish(
      topics::kRelightVisibility, {.latch_key = service_.bus->source(), .tensors = ring_.write(std::span(&source, 1))},
      [&](auto& builder, auto header) {
        const auto ids_at = builder.CreateVector(ids);
        if (shares_.alone()) {
          return wire::CreateRelightVisibility(builder, header, model_generation, scene.version, count, ids_at);
        }
        return wire::CreateRelightVisibility(builder, header, model_generation, scene.version, count, ids_at,
                                             static_cast<std::uint32_t>(shares_.sources().size()), shares_.part(),
                                             shares_.division(), std::uint32_t{1} << mine.page_shift,
                                             builder.CreateVector(pages));
      });
  ++published_;
}

}  // namespace splatbus::relight

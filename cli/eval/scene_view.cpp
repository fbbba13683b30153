#include "scene_view.h"

#include <chrono>
#include <cstddef>

#include "metrics/image_io.h"
#include "wire/convert.h"
#include "wire/scene_generated.h"

namespace splatbus::cli {

namespace {

constexpr std::chrono::milliseconds kPatience(50);

}  // namespace

LightDepths::LightDepths(std::shared_ptr<bus::Context> context)
    : context_(std::move(context)), thread_([this](const std::stop_token& stop) { receive(stop); }) {}

void LightDepths::keep(bool all) {
  const std::scoped_lock lock(mutex_);
  keep_all_ = all;
}

std::optional<SceneLights> LightDepths::find(const SceneState& scene) {
  const std::scoped_lock lock(mutex_);
  for (const auto& [key, message] : newest_) bus::guarded(message, [&, &message = message] { copy(message); });
  return relight::find_lights(scene.light, maps_);
}

void LightDepths::receive(const std::stop_token& stop) {
  bus::Subscriber subscriber(context_, {std::string(topics::kSceneLightDepth.name)});
  while (!stop.stop_requested()) {
    auto message = subscriber.receive(kPatience);
    if (!message) continue;
    const std::scoped_lock lock(mutex_);
    bus::guarded(*message, [&] {
      const auto& depth = message->root<wire::SceneLightDepth>();
      if (keep_all_) copy(*message);
      // Maps of a request that is no more would never be whole beside those of the one that is.
      std::erase_if(newest_, [&](const auto& entry) {
        return entry.first.first == depth.light_id() &&
               entry.second.template root<wire::SceneLightDepth>().light_maps() != depth.light_maps();
      });
      newest_.insert_or_assign({depth.light_id(), depth.light_map()}, *message);
    });
  }
}

void LightDepths::copy(const bus::Message& message) {
  const auto& depth = message.root<wire::SceneLightDepth>();
  const auto key = relight::MapRing::key_of(depth);
  const Camera camera = from_wire(*depth.camera());
  if (maps_.holds(key, camera)) return;
  const auto tensor = message.tensor("light_depth", bus::ElementType::F32, {camera.height, camera.width});
  if (!tensor) return;
  const auto values = std::make_shared<std::vector<std::byte>>(tensor->bytes());
  if (!tensor->copy(values->data())) return;
  maps_.put(key, {.camera = camera, .depth_m = {values, values->data()}}, depth.scene()->version());
}

SceneView::SceneView(int threads) : renderer_(raster::make_model_renderer(Device::Cpu, threads)) {}

std::optional<cv::Mat> SceneView::render(LiveScene& live, const Camera& camera, const SceneState& scene,
                                         const SceneLights* lights) {
  const PublishedModel* model = live.model(Device::Cpu);
  if (model == nullptr || model->average().count == 0) return {};
  GaussiansView gaussians = model->average();
  if (lights != nullptr) {
    visibility_.resize(lights->size() * gaussians.count);
    relight::compute_visibility(stream_, gaussians, scene.objects, relight::mapped(*lights), {}, visibility_.data());
    gaussians.visibility_u8 = visibility_.data();
    gaussians.visibility_stride = gaussians.count;
    gaussians.visibility_rows = static_cast<std::uint32_t>(lights->size());
  }
  renderer_->read_in_place(gaussians);
  renderer_->draw(camera, scene, {}, render_);
  if (!model->still_valid()) return {};
  const bool linear = gaussians.layout.appearance == Appearance::Transfer;
  return metrics::from_planes(render_.color.data.data(), render_.color.width, render_.color.height, linear);
}

}  // namespace splatbus::cli

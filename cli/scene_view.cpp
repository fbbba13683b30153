#include "scene_view.h"

#include <chrono>
#include <utility>

#include "metrics/image_io.h"
#include "wire/convert.h"
#include "wire/scene_generated.h"

namespace splatbus::cli {

namespace {

constexpr std::size_t kMapsKept = 8;
constexpr std::chrono::milliseconds kPatience(50);

}  // namespace

LightDepths::LightDepths(std::shared_ptr<bus::Context> context)
    : context_(std::move(context)), thread_([this](const std::stop_token& stop) { receive(stop); }) {}

void LightDepths::keep(bool all) {
  const std::scoped_lock lock(mutex_);
  keep_all_ = all;
}

std::shared_ptr<const LightDepths::Map> LightDepths::find(std::uint64_t version) {
  const std::scoped_lock lock(mutex_);
  for (const auto& map : maps_) {
    if (map->version == version) return map;
  }
  std::shared_ptr<const Map> found;
  if (newest_) {
    bus::guarded(*newest_, [&] {
      if (newest_->root<wire::SceneLightDepth>().scene()->version() == version) found = copy(*newest_);
    });
  }
  if (found) maps_.push_back(found);
  return found;
}

void LightDepths::receive(const std::stop_token& stop) {
  bus::Subscriber subscriber(context_, {std::string(topics::kSceneLightDepth.name)});
  while (!stop.stop_requested()) {
    auto message = subscriber.receive(kPatience);
    if (!message) continue;
    const std::scoped_lock lock(mutex_);
    if (keep_all_) {
      bus::guarded(*message, [&] {
        if (auto map = copy(*message)) maps_.push_back(std::move(map));
      });
    }
    newest_ = std::move(message);
    while (maps_.size() > kMapsKept) maps_.pop_front();
  }
}

std::shared_ptr<const LightDepths::Map> LightDepths::copy(const bus::Message& message) {
  const auto& depth = message.root<wire::SceneLightDepth>();
  auto map = std::make_shared<Map>();
  map->version = depth.scene()->version();
  map->camera = from_wire(*depth.camera());
  const auto tensor = message.tensor("light_depth", bus::ElementType::F32, {map->camera.height, map->camera.width});
  if (!tensor) return nullptr;
  map->depth_m.resize(tensor->elements());
  if (!tensor->copy(map->depth_m.data())) return nullptr;
  return map;
}

SceneView::SceneView(int threads) : renderer_(raster::make_model_renderer(Device::Cpu, threads)) {}

std::optional<cv::Mat> SceneView::render(LiveScene& live, const Camera& camera, const SceneState& scene,
                                         const LightDepths::Map* map) {
  const PublishedModel* model = live.model(Device::Cpu);
  if (model == nullptr || model->average().count == 0) return {};
  GaussiansView gaussians = model->average();
  if (map != nullptr) {
    visibility_.resize(gaussians.count);
    const relight::MappedLight sun{.source = relight::sun_source(scene.light),
                                   .maps = {{.camera = map->camera, .depth_m = map->depth_m.data()}}};
    relight::compute_visibility(stream_, gaussians, scene.objects, {{sun}}, {}, visibility_.data());
    gaussians.visibility_u8 = visibility_.data();
    gaussians.visibility_stride = gaussians.count;
  }
  renderer_->read_in_place(gaussians);
  renderer_->draw(camera, scene, {}, render_);
  if (!model->still_valid()) return {};
  const bool linear = gaussians.layout.appearance == Appearance::Transfer;
  return metrics::from_planes(render_.color.data.data(), render_.color.width, render_.color.height, linear);
}

}  // namespace splatbus::cli

#include "raster/cuda/train_step.h"

#include <stdexcept>
#include <string>

#include "raster/cuda/train_step_impl.h"

namespace splatbus::raster::cuda {

TrainStep::Impl::Impl(TrainStepOptions o) : options(o) {
  check(cudaStreamCreateWithFlags(&stream, cudaStreamNonBlocking), "creating a stream");
  check(cudaMallocHost(reinterpret_cast<void**>(&host_pair_count), sizeof(std::uint32_t)), "allocating pinned memory");
  *host_pair_count = 0;
}

TrainStep::Impl::~Impl() {
  cudaStreamSynchronize(stream);
  groups.clear();
  cudaFreeHost(host_pair_count);
  cudaStreamDestroy(stream);
}

TrainStep::TrainStep(TrainStepOptions options) : impl_(std::make_unique<Impl>(options)) {}
TrainStep::~TrainStep() = default;

void TrainStep::set_model(const DeviceGaussians& gaussians, const std::uint32_t* host_object_id, bool keep_moments) {
  check(cudaStreamSynchronize(impl_->stream), "changing the model");
  clear_groups();
  const auto elements =
      static_cast<std::size_t>(gaussians.layout.channels()) * static_cast<std::size_t>(gaussians.stride);
  const bool same = impl_->first.size() == elements && impl_->gaussians.layout == gaussians.layout &&
                    impl_->gaussians.stride == gaussians.stride;
  impl_->gaussians = gaussians;
  impl_->host_object_id.clear();
  if (host_object_id != nullptr) impl_->host_object_id.assign(host_object_id, host_object_id + gaussians.count);
  if (!impl_->options.training) return;
  impl_->first.resize(elements);
  impl_->second.resize(elements);
  impl_->steps.resize(static_cast<std::size_t>(gaussians.stride));
  if (!(keep_moments && same)) {
    impl_->first.clear(impl_->stream);
    impl_->second.clear(impl_->stream);
    impl_->steps.clear(impl_->stream);
  }
}

void TrainStep::set_learning_rates(const std::vector<float>& rates) {
  if (rates.size() != static_cast<std::size_t>(impl_->gaussians.layout.channels())) {
    throw std::invalid_argument("TrainStep: one learning rate a channel is needed");
  }
  impl_->learning_rate.upload(rates.data(), rates.size(), impl_->stream);
  check(cudaStreamSynchronize(impl_->stream), "copying the learning rates");
}

std::size_t TrainStep::add_group(std::span<const TrainView> views) {
  if (views.empty() || views.size() > static_cast<std::size_t>(kMaxBatch)) {
    throw std::invalid_argument("TrainStep: a group has 1 to " + std::to_string(kMaxBatch) + " views");
  }
  auto group = std::make_unique<Group>();
  group->views.assign(views.begin(), views.end());
  group->width = static_cast<int>(views[0].view.camera.width);
  group->height = static_cast<int>(views[0].view.camera.height);
  std::vector<SceneView> scenes;
  std::vector<const std::uint8_t*> colors, albedos;
  for (const TrainView& view : views) {
    if (static_cast<int>(view.view.camera.width) != group->width ||
        static_cast<int>(view.view.camera.height) != group->height) {
      throw std::invalid_argument("TrainStep: all views of a group have one size");
    }
    scenes.push_back(view.view);
    colors.push_back(view.color);
    albedos.push_back(view.albedo);
  }
  const ViewTables tables = make_view_tables(scenes, impl_->gaussians.layout.appearance);
  if (!tables.object_ids.empty() && !impl_->host_object_id.empty()) {
    const auto slots = object_slots(impl_->host_object_id.data(), impl_->host_object_id.size(), tables.object_ids);
    group->object_slot.upload(slots.data(), slots.size(), impl_->stream);
    check(cudaStreamSynchronize(impl_->stream), "copying object slots");
  }
  group->device_views.upload(tables.views.data(), tables.views.size(), impl_->stream);
  group->object_views.upload(tables.object_views.data(), tables.object_views.size(), impl_->stream);
  group->color_targets.upload(colors.data(), colors.size(), impl_->stream);
  group->albedo_targets.upload(albedos.data(), albedos.size(), impl_->stream);
  const auto tiles = static_cast<std::size_t>((group->width + kTileSize - 1) / kTileSize) *
                     static_cast<std::size_t>((group->height + kTileSize - 1) / kTileSize) * views.size();
  group->tile_range.resize(tiles);
  group->listed.resize(static_cast<std::size_t>(impl_->gaussians.count));
  group->patch_depth_limit.resize(tiles * kPatches);
  // Nothing is known to be hidden before the first blend: all ones is a NaN, which no depth lies beyond.
  check(cudaMemsetAsync(group->patch_depth_limit.data(), 0xFF, sizeof(float) * tiles * kPatches, impl_->stream),
        "setting depth limits");
  check(cudaStreamSynchronize(impl_->stream), "copying a group");
  impl_->groups.push_back(std::move(group));
  return impl_->groups.size() - 1;
}

void TrainStep::clear_groups() {
  check(cudaStreamSynchronize(impl_->stream), "dropping groups");
  impl_->groups.clear();
  impl_->last = nullptr;
}

void TrainStep::step(std::size_t group) {
  if (!impl_->options.training) throw std::logic_error("TrainStep: made for forward() only");
  impl_->run(*impl_->groups.at(group), true);
}
void TrainStep::forward(std::size_t group) {
  impl_->run(*impl_->groups.at(group), false);
}

std::vector<float> TrainStep::losses() {
  if (impl_->last == nullptr) return {};
  std::vector<float> host(impl_->last->views.size());
  check(cudaMemcpyAsync(host.data(), impl_->workspace.view().loss, sizeof(float) * host.size(), cudaMemcpyDeviceToHost,
                        impl_->stream),
        "reading losses");
  check(cudaStreamSynchronize(impl_->stream), "reading losses");
  return host;
}

const float* TrainStep::color() const {
  return impl_->workspace.view().color;
}
cudaStream_t TrainStep::stream() const {
  return impl_->stream;
}

std::size_t TrainStep::bytes() const {
  std::size_t total = impl_->workspace.bytes() + (impl_->first.size() + impl_->second.size() + impl_->steps.size()) * 4;
  for (const auto& group : impl_->groups) {
    total += group->entries.size() * sizeof(std::uint32_t) + group->tile_range.size() * sizeof(uint2) +
             group->patch_depth_limit.size() * sizeof(float) +
             (group->object_slot.size() + group->listed.size()) * sizeof(std::uint16_t);
  }
  return total;
}

}  // namespace splatbus::raster::cuda

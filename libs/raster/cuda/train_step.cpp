#include "raster/cuda/train_step.h"

#include <stdexcept>
#include <utility>

#include "raster/cuda/train_step_impl.h"

namespace splatbus::raster::cuda {

TrainStep::Impl::~Impl() {
  cudaStreamSynchronize(stream);
}

TrainStep::TrainStep(TrainStepOptions options) : impl_(std::make_unique<Impl>(options)) {}
TrainStep::~TrainStep() = default;

void TrainStep::set_options(const TrainStepOptions& options) {
  const bool training = impl_->options.training;
  const int rebuild_interval = impl_->options.rebuild_interval;
  impl_->options = options;
  impl_->options.training = training;
  impl_->options.rebuild_interval = rebuild_interval;
  impl_->adam.gather_statistics(options.statistics && training, impl_->stream);
  for (const auto& group : impl_->groups) {
    group->lists_built = false;
    group->invalidate_graphs();
  }
}

void TrainStep::set_model(const DeviceGaussians& gaussians) {
  clear_groups();
  impl_->gaussians = gaussians;
  if (!impl_->options.training) return;
  impl_->adam.reset(gaussians.layout, gaussians.count, gaussians.stride, impl_->stream);
  impl_->adam.gather_statistics(impl_->options.statistics, impl_->stream);
}

void TrainStep::follow_model(const DeviceGaussians& gaussians) {
  if (gaussians.layout != impl_->gaussians.layout) throw std::invalid_argument("TrainStep: a model keeps its layout");
  if (impl_->options.training) impl_->adam.resize(gaussians.count, gaussians.stride, impl_->stream);
  const int count_before = std::exchange(impl_->gaussians, gaussians).count;
  for (const auto& group : impl_->groups) group->model_changed(gaussians.count, count_before);
}

void TrainStep::move_columns(const std::uint32_t* from, const std::uint32_t* to, int count) {
  impl_->adam.move(from, to, count, impl_->stream);
}

void TrainStep::set_learning_rates(const std::vector<float>& rates) {
  if (rates.size() != static_cast<std::size_t>(impl_->gaussians.layout.channels())) {
    throw std::invalid_argument("TrainStep: one learning rate a channel is needed");
  }
  impl_->learning_rate.resize(rates.size());
  impl_->staging.copy(impl_->learning_rate.data(), std::as_bytes(std::span(rates)), impl_->stream);
}

std::size_t TrainStep::add_group(std::span<const TrainView> views) {
  if (!views.empty()) {
    const Camera& camera = views[0].view.camera;
    impl_->workspace.require(impl_->request_for(static_cast<int>(camera.width), static_cast<int>(camera.height),
                                                static_cast<int>(views.size()), Targets(views),
                                                ViewGroup::kFirstPairs));
  }
  auto group = std::make_unique<ViewGroup>(views);
  group->set_views(views, impl_->gaussians.layout.appearance, impl_->options.use_depth_limit, impl_->staging,
                   impl_->stream);
  impl_->groups.push_back(std::move(group));
  return impl_->groups.size() - 1;
}

void TrainStep::renew_group(std::size_t index, std::span<const TrainView> views) {
  ViewGroup& group = *impl_->groups.at(index);
  group.renewed = true;
  group.set_views(views, impl_->gaussians.layout.appearance, impl_->options.use_depth_limit, impl_->staging,
                  impl_->stream);
}

void TrainStep::clear_groups() {
  impl_->retire(true);
  check(cudaStreamSynchronize(impl_->stream), "dropping groups");
  impl_->groups.clear();
  impl_->last = nullptr;
  impl_->last_view = {};
}

void TrainStep::step(std::size_t group) {
  if (!impl_->options.training) throw std::logic_error("TrainStep: made for forward() only");
  impl_->run(group, true);
}
void TrainStep::forward(std::size_t group) {
  impl_->run(group, false);
}

std::vector<TrainStep::Report> TrainStep::finished(bool wait) {
  impl_->retire(wait);
  std::vector<Report> reports(impl_->reports.begin(), impl_->reports.end());
  impl_->reports.clear();
  return reports;
}

std::vector<float> TrainStep::losses() {
  if (impl_->last == nullptr) return {};
  std::vector<float> host(static_cast<std::size_t>(impl_->last->batch));
  check(cudaMemcpyAsync(host.data(), impl_->last->figures()->loss, sizeof(float) * host.size(), cudaMemcpyDeviceToHost,
                        impl_->stream),
        "reading losses");
  check(cudaStreamSynchronize(impl_->stream), "reading losses");
  return host;
}

const float* TrainStep::color() const {
  return impl_->last_view.color;
}
ScreenStatistics TrainStep::statistics() const {
  return impl_->adam.statistics();
}
void TrainStep::clear_statistics() {
  impl_->adam.clear_statistics(impl_->stream);
}
const WorkspaceView& TrainStep::workspace() const {
  return impl_->last_view;
}
cudaStream_t TrainStep::stream() const {
  return impl_->stream;
}

std::size_t TrainStep::bytes() const {
  std::size_t total = impl_->workspace.bytes() + impl_->adam.bytes();
  for (const auto& group : impl_->groups) total += group->bytes();
  return total;
}

}  // namespace splatbus::raster::cuda

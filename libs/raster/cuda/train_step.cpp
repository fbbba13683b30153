#include "raster/cuda/train_step.h"

#include <algorithm>
#include <numeric>
#include <stdexcept>
#include <utility>

namespace splatbus::raster::cuda {
namespace {

// Numbers of views and sizes of pictures that are known at once.
constexpr std::size_t kMaxBatches = 32;

}  // namespace

TrainStep::TrainStep(const TrainStepOptions& options) : options_(options) {
  for (cudaEvent_t& done : done_) check(cudaEventCreateWithFlags(&done, cudaEventDisableTiming), "making an event");
}

TrainStep::~TrainStep() {
  cudaStreamSynchronize(stream());
  for (cudaEvent_t done : done_) {
    if (done != nullptr) cudaEventDestroy(done);
  }
}

void TrainStep::set_options(const TrainStepOptions& options) {
  const bool training = options_.training;
  options_ = options;
  options_.training = training;
  adam_.gather_statistics(options.statistics && training, stream());
  invalidate_graphs();
}

void TrainStep::invalidate_graphs() {
  for (auto& [size, batch] : batches_) batch.graph.invalidate();
}

void TrainStep::set_model(const DeviceGaussians& gaussians, std::span<const IndexRange> ranges) {
  retire(true);
  repeats_.clear();
  batches_.clear();
  last_views_.clear();
  last_workspace_ = {};
  gaussians_ = gaussians;
  if (!options_.training) return;
  adam_.reset(gaussians.layout, gaussians.count, ranges, stream());
  adam_.gather_statistics(options_.statistics, stream());
}

void TrainStep::follow_model(const DeviceGaussians& gaussians, const ModelChange& change) {
  if (gaussians.layout != gaussians_.layout) throw std::invalid_argument("TrainStep: a model keeps its layout");
  if (options_.training) adam_.follow(gaussians.count, change, options_.beta2, stream());
  const int count_before = std::exchange(gaussians_, gaussians).count;
  for (auto& [size, batch] : batches_) batch.model_changed(gaussians.count, count_before);
}

void TrainStep::set_learning_rates(const std::vector<float>& rates) {
  if (rates.size() != static_cast<std::size_t>(gaussians_.layout.channels())) {
    throw std::invalid_argument("TrainStep: one learning rate a channel is needed");
  }
  learning_rate_.upload(rates.data(), rates.size(), stream());
}

std::vector<TrainStep::Part> TrainStep::split(std::span<const TrainView> views) {
  std::map<std::pair<std::uint32_t, std::uint32_t>, std::vector<TrainView>> by_size;  // seldom more than one
  for (const TrainView& view : views) by_size[{view.view.camera.width, view.view.camera.height}].push_back(view);
  std::vector<Part> parts;
  for (auto& [size, of_size] : by_size) {
    const std::size_t pixels = std::max<std::size_t>(std::size_t{size.first} * size.second, 1);
    const std::size_t at_once = std::clamp<std::size_t>(kMaxPixels / pixels, 1, kMaxBatch);
    for (std::size_t first = 0; first < of_size.size(); first += at_once) {
      const auto begin = of_size.begin() + static_cast<std::ptrdiff_t>(first);
      const std::size_t count = std::min(at_once, of_size.size() - first);
      parts.push_back({.views = {begin, begin + static_cast<std::ptrdiff_t>(count)}});
    }
  }
  return parts;
}

void TrainStep::step(std::span<const TrainView> views) {
  if (!options_.training) throw std::logic_error("TrainStep: made for forward() only");
  enqueue_repeats();
  std::vector<Part> parts = split(views);
  if (!parts.empty()) parts.back().ends_step = true;
  const bool looks = options_.look_interval > 0 && --steps_to_look_ <= 0;
  if (looks) steps_to_look_ = options_.look_interval;
  for (Part& part : parts) part.looks = looks;
  for (Part& part : parts) launch(std::move(part));
}

void TrainStep::forward(std::span<const TrainView> views) {
  for (Part& part : split(views)) {
    part.training = false;
    launch(std::move(part));
  }
}

ViewBatch& TrainStep::batch_for(std::span<const TrainView> views) {
  const Camera& camera = views[0].view.camera;
  const int width = static_cast<int>(camera.width), height = static_cast<int>(camera.height);
  const int count = static_cast<int>(views.size());
  if (batches_.size() >= kMaxBatches && !batches_.contains({width, height, count})) {
    retire(true);
    batches_.clear();
  }
  return batches_.try_emplace({width, height, count}, count, width, height).first->second;
}

void TrainStep::launch(Part part) {
  retire(false);
  if (in_flight_.size() == ViewBatch::kStepsInFlight) retire_one(true);
  ViewBatch& batch = batch_for(part.views);
  const std::vector<float> limits = loss_limits(part.views);
  batch.set_views(part.views, limits, gaussians_.layout.appearance, stream());
  if (!batch.sized()) {
    size_lists(batch);
    batch.set_views(part.views, limits, gaussians_.layout.appearance, stream());
  }
  const WorkspaceView w = workspace_for(batch);
  if (part.training) {
    batch.graph.launch(stream(), [&] {
      enqueue_forward(batch, w);
      losses(batch, w);
      launch_blend_backward(gaussians_, w, stream());
      update(batch, w);
    });
  } else {
    enqueue_forward(batch, w);
  }
  const std::size_t slot = launched_++ % done_.size();
  if (part.looks) look_at_pages(batch, w, slot);
  part.pages = part.looks ? page_count() : 0;
  check(cudaMemcpyAsync(host_counts_.data() + slot, w.counts, sizeof(StepCounts), cudaMemcpyDeviceToHost, stream()),
        "reading a step's figures");
  check(cudaEventRecord(done_[slot], stream()), "recording an event");
  if (in_flight_.empty()) busy_since_ = Clock::now();
  part.batch = &batch;
  part.isect_capacity = w.isect_capacity;
  part.list_capacity = w.list_capacity;
  last_views_ = part.views;
  last_workspace_ = w;
  in_flight_.push_back(std::move(part));
}

std::vector<float> TrainStep::loss_limits(std::span<const TrainView> views) const {
  std::vector<float> limits;
  for (const TrainView& view : views) {
    // A step's losses are each view's part of their mean.
    limits.push_back(loss_history_.limit(view.view.camera) / static_cast<float>(views.size()));
  }
  return limits;
}

void TrainStep::enqueue_repeats() {
  while (!repeats_.empty()) {
    Part part = std::move(repeats_.front());
    repeats_.pop_front();
    launch(std::move(part));
  }
}

bool TrainStep::retire_one(bool wait) {
  if (in_flight_.empty()) return false;
  const std::size_t slot = retired_ % done_.size();
  if (wait) {
    check(cudaEventSynchronize(done_[slot]), "waiting for a step");
  } else {
    const cudaError_t status = cudaEventQuery(done_[slot]);
    if (status == cudaErrorNotReady) return false;
    check(status, "asking for a step");
  }
  Part part = std::move(in_flight_.front());
  in_flight_.pop_front();
  ++retired_;
  const StepCounts& counts = host_counts_[slot];
  part.batch->note_lists(counts.isects, counts.seen);
  if (!part.training) return true;
  if (counts.isects > part.isect_capacity || counts.seen > part.list_capacity) {
    repeats_.push_back(std::move(part));
    return true;
  }
  report(part, slot);
  return true;
}

void TrainStep::report(const Part& part, std::size_t slot) {
  const StepCounts& counts = host_counts_[slot];
  const std::size_t views = part.views.size();
  for (std::size_t k = 0; k < views; ++k) {
    // A step's losses are each view's part of their mean.
    const float own_loss = counts.loss[k] * static_cast<float>(views);
    loss_history_.add(part.views[k].view.camera, own_loss);
    Look look{.keep = part.views[k].keep, .loss = own_loss, .looked = part.looks, .pages = {}};
    const PageSums* const sums = host_sums_.data() + slot * look_room_ + k * part.pages;
    for (std::size_t page = 0; page < part.pages; ++page) {
      if (sums[page].pairs == 0) continue;
      look.pages.push_back({.page = static_cast<std::uint32_t>(page),
                            .pairs = sums[page].pairs,
                            .error = static_cast<double>(sums[page].error) / sums[page].pairs});
    }
    report_.looks.push_back(std::move(look));
  }
  const auto before = static_cast<double>(report_.views), here = static_cast<double>(views);
  const auto mean = [&](double sum_before, double value) {
    return (sum_before * before + value * here) / (before + here);
  };
  const Camera& camera = part.views.front().view.camera;
  const double pixels = here * camera.width * camera.height;
  report_.loss = mean(report_.loss, std::accumulate(counts.loss, counts.loss + views, 0.0));
  report_.masked_share = mean(report_.masked_share, pixels > 0 ? counts.masked / pixels : 0);
  report_.views += views;
  report_.steps += part.ends_step ? 1 : 0;
  const Clock::time_point now = Clock::now();
  report_.seconds += std::chrono::duration<double>(now - std::exchange(busy_since_, now)).count();
}

void TrainStep::retire(bool wait) {
  while (retire_one(wait)) {
  }
}

TrainStep::Report TrainStep::finished(bool wait) {
  retire(wait);
  while (wait && !repeats_.empty()) {
    enqueue_repeats();
    retire(true);
  }
  return std::exchange(report_, {});
}

std::vector<float> TrainStep::losses() {
  if (last_workspace_.counts == nullptr) return {};
  std::vector<float> host(last_views_.size());
  check(
      cudaMemcpyAsync(host.data(), last_workspace_.loss, sizeof(float) * host.size(), cudaMemcpyDeviceToHost, stream()),
      "reading losses");
  check(cudaStreamSynchronize(stream()), "reading losses");
  return host;
}

std::size_t TrainStep::bytes() const {
  std::size_t total = workspace_.bytes() + adam_.bytes();
  for (const auto& [size, batch] : batches_) total += batch.bytes();
  return total;
}

}  // namespace splatbus::raster::cuda

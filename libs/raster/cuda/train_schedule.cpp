#include <algorithm>
#include <array>
#include <functional>
#include <numeric>

#include "raster/cuda/train_step_impl.h"

namespace splatbus::raster::cuda {
namespace {

// Of steps that nobody asks about; more than anybody enqueues between two questions.
constexpr std::size_t kKeptReports = 4096;

}  // namespace

/// Lists that are used once need not be kept for each group.
bool TrainStep::Impl::keeps_lists() const {
  return options.rebuild_interval > 1;
}

WorkspaceRequest TrainStep::Impl::request_for(int width, int height, int batch, const Targets& targets,
                                              std::uint32_t pairs) const {
  const bool transfer = gaussians.layout.appearance == Appearance::Transfer;
  return {.count = gaussians.count,
          .capacity = static_cast<int>(gaussians.stride),
          .batch = batch,
          .width = width,
          .height = height,
          .object_count = 1,
          .albedo = options.albedo_weight > 0.0F && transfer && targets.albedo,
          .depth = options.depth_weight > 0.0F && targets.depth,
          .training = options.training,
          .lists = !keeps_lists(),
          .pair_capacity = pairs};
}

WorkspaceView TrainStep::Impl::workspace_for(ViewGroup& group) {
  const WorkspaceRequest request =
      request_for(group.width, group.height, group.batch, group.targets(), group.pair_capacity);
  bool moved = false;
  try {
    moved = workspace.reserve(request);
  } catch (const StepTooLarge&) {
    group.forget_size();
    throw;
  }
  if (moved) {
    for (const auto& other : groups) other->invalidate_graphs();
  }
  if (keeps_lists()) group.keep_entries(stream);
  group.follow_model(gaussians, staging, stream);
  WorkspaceView w = workspace.view();
  group.bind(w);
  return w;
}

ProjectOptions TrainStep::Impl::project_options(bool rebuild) const {
  ProjectOptions project = options.project;
  project.emit_pairs = rebuild;
  project.use_depth_limit = options.use_depth_limit;
  return project;
}

void TrainStep::Impl::picture_loss(const float* rendered, const ViewGroup& group, bool of_albedo, float* gradient,
                                   const WorkspaceView& w) {
  const LossKernelOptions loss{.ssim_weight = options.ssim_weight,
                               .weight = (of_albedo ? options.albedo_weight : 1.0F) / static_cast<float>(group.batch),
                               .encode_srgb = gaussians.layout.appearance == Appearance::Transfer};
  launch_loss(rendered, of_albedo ? group.albedo_targets() : group.color_targets(), gradient, w, loss, stream);
}

void TrainStep::Impl::losses(const ViewGroup& group, const WorkspaceView& w) {
  check(cudaMemsetAsync(w.loss, 0, sizeof(float) * kMaxBatch, stream), "clearing the losses");
  picture_loss(w.color, group, false, w.color_gradient, w);
  if (w.albedo != nullptr) picture_loss(w.albedo, group, true, w.albedo_gradient, w);
  if (w.depth == nullptr) return;
  const float values = static_cast<float>(group.batch) * static_cast<float>(w.width) * static_cast<float>(w.height);
  launch_depth_loss(group.depth_targets(), w, options.depth_weight / values, stream);
}

void TrainStep::Impl::update(const WorkspaceView& w) {
  const AdamOptions adam_options{.beta1 = options.beta1,
                                 .beta2 = options.beta2,
                                 .epsilon = options.epsilon,
                                 .learning_rate = learning_rate.data(),
                                 .active_channels = options.active_channels,
                                 .unit_albedo = options.unit_albedo,
                                 .half_rate_steps = options.half_rate_steps,
                                 .least_rate = options.least_rate};
  launch_update(gaussians, w, project_options(false), adam.view(), adam_options, adam.statistics(), stream);
}

void TrainStep::Impl::enqueue_forward(const WorkspaceView& w, bool rebuild) {
  launch_project(gaussians, w, project_options(rebuild), stream);
  if (rebuild) launch_sort(w, stream);
  launch_blend_forward(gaussians, w, stream);
}

void TrainStep::Impl::enqueue_training(const ViewGroup& group, const WorkspaceView& w) {
  losses(group, w);
  launch_blend_backward(gaussians, w, stream);
  update(w);
}

/// Sizes the pair buffers for a group's first build: the only wait.
void TrainStep::Impl::size_lists(ViewGroup& group) {
  std::uint32_t pairs = 0;
  launch_project(gaussians, workspace_for(group), project_options(true), stream);
  check(cudaMemcpyAsync(&pairs, &group.figures()->pairs, sizeof(pairs), cudaMemcpyDeviceToHost, stream),
        "reading the pair count");
  check(cudaStreamSynchronize(stream), "sizing the tile lists");
  group.size_by(pairs);
}

bool TrainStep::Impl::retire_one(bool wait) {
  const auto step = in_flight.pop(wait);
  if (!step) return false;
  ViewGroup& group = *groups.at(step->group);
  const StepFigures& figures = step->figures;
  const bool changed = figures.pairs <= step->pair_capacity;
  group.note_pairs(figures.pairs);
  if (!step->training) return true;
  if (reports.size() == kKeptReports) reports.pop_front();
  reports.push_back({.loss = std::accumulate(figures.loss, figures.loss + group.batch, 0.0F), .changed = changed});
  return true;
}

void TrainStep::Impl::retire(bool wait) {
  while (retire_one(wait)) {
  }
}

void TrainStep::Impl::run(std::size_t index, bool train) {
  ViewGroup& group = *groups.at(index);
  retire(false);
  if (in_flight.full()) retire_one(true);
  last_view = {};  // its memory may be given back, and what lies there change, whether this step comes about or not
  if (!group.sized) size_lists(group);
  WorkspaceView w = workspace_for(group);
  const bool rebuild = !group.lists_built || group.steps >= std::max(1, options.rebuild_interval);
  const auto enqueue = [&] {
    enqueue_forward(w, rebuild);
    if (train) enqueue_training(group, w);
  };
  if (!options.use_graph || !train) {
    enqueue();
  } else {
    (rebuild ? group.rebuild_graph : group.reuse_graph).launch(stream, enqueue);
  }
  in_flight.push({.group = index, .pair_capacity = group.pair_capacity, .training = train, .figures = {}},
                 group.figures(), stream);
  group.lists_built = true;
  group.steps = rebuild ? 1 : group.steps + 1;
  last = &group;
  last_view = w;
}

std::vector<TrainStep::StageTime> TrainStep::time_stages(std::size_t index, int repeats) {
  ViewGroup& group = *impl_->groups.at(index);
  Impl& impl = *impl_;
  impl.run(index, impl.options.training);
  const WorkspaceView w = impl.workspace_for(group);
  const std::array<std::pair<const char*, std::function<void()>>, 7> stages = {{
      {"project_and_list", [&] { launch_project(impl.gaussians, w, impl.project_options(true), impl.stream); }},
      {"sort", [&] { launch_sort(w, impl.stream); }},
      {"project", [&] { launch_project(impl.gaussians, w, impl.project_options(false), impl.stream); }},
      {"blend_forward", [&] { launch_blend_forward(impl.gaussians, w, impl.stream); }},
      {"loss", [&] { impl.losses(group, w); }},
      {"blend_backward", [&] { launch_blend_backward(impl.gaussians, w, impl.stream); }},
      {"update", [&] { impl.update(w); }},
  }};
  std::array<cudaEvent_t, stages.size() + 1> marks{};
  for (cudaEvent_t& mark : marks) check(cudaEventCreate(&mark), "making an event");
  std::array<std::vector<float>, stages.size()> samples;
  constexpr std::size_t kForwardStages = 4;
  const std::size_t count = impl.options.training ? stages.size() : kForwardStages;
  for (int k = 0; k < repeats; ++k) {
    check(cudaEventRecord(marks[0], impl.stream), "timing");
    for (std::size_t s = 0; s < count; ++s) {
      stages[s].second();
      check(cudaEventRecord(marks[s + 1], impl.stream), "timing");
    }
    check(cudaEventSynchronize(marks[count]), "timing");
    for (std::size_t s = 0; s < count; ++s) {
      float milliseconds = 0.0F;
      check(cudaEventElapsedTime(&milliseconds, marks[s], marks[s + 1]), "timing");
      samples[s].push_back(milliseconds);
    }
  }
  for (cudaEvent_t& mark : marks) cudaEventDestroy(mark);
  std::vector<StageTime> times;
  for (std::size_t s = 0; s < count; ++s) {
    std::nth_element(samples[s].begin(), samples[s].begin() + repeats / 2, samples[s].end());
    times.push_back({stages[s].first, samples[s][static_cast<std::size_t>(repeats) / 2]});
  }
  return times;
}

}  // namespace splatbus::raster::cuda

#include <algorithm>
#include <array>

#include "raster/cuda/train_step_impl.h"

namespace splatbus::raster::cuda {
namespace {

/// Pairs to make room for when there were `count`.
std::uint32_t with_room(std::uint32_t count) {
  return count + count / 8 + 1024;
}

}  // namespace

bool TrainStep::Impl::albedo() const {
  return options.albedo_weight > 0.0F && gaussians.layout.appearance == Appearance::Transfer;
}

/// Lists that are used once need not be kept for each group.
bool TrainStep::Impl::keeps_lists() const {
  return options.rebuild_interval > 1;
}

WorkspaceView TrainStep::Impl::workspace_for(const Group& group) {
  WorkspaceRequest request{.count = gaussians.count,
                           .batch = static_cast<int>(group.views.size()),
                           .width = group.width,
                           .height = group.height,
                           .object_count = 1,
                           .albedo = albedo(),
                           .training = options.training,
                           .lists = !keeps_lists(),
                           .pair_capacity = pair_capacity};
  if (workspace.reserve(request)) drop_graphs();
  WorkspaceView w = workspace.view();
  w.views = group.device_views.data();
  w.object_views = group.object_views.data();
  w.object_count = static_cast<int>(group.object_views.size() / group.views.size());
  w.object_slot = group.object_slot.size() == 0 ? nullptr : group.object_slot.data();
  w.tile_range = group.tile_range.data();
  w.patch_depth_limit = group.patch_depth_limit.data();
  if (keeps_lists()) w.pair_entries[1] = group.entries.data();
  w.listed = group.listed.data();
  return w;
}

ProjectOptions TrainStep::Impl::project_options(bool rebuild) const {
  ProjectOptions project = options.project;
  project.emit_pairs = rebuild;
  project.use_depth_limit = options.use_depth_limit;
  return project;
}

void TrainStep::Impl::read_pair_count(const WorkspaceView& w) {
  check(cudaMemcpyAsync(host_pair_count, w.pair_count, sizeof(std::uint32_t), cudaMemcpyDeviceToHost, stream),
        "reading the pair count");
}

void TrainStep::Impl::picture_loss(const float* rendered, const Group& group, bool of_albedo, float* gradient,
                                   const WorkspaceView& w) {
  const LossKernelOptions loss{
      .ssim_weight = options.ssim_weight,
      .weight = (of_albedo ? options.albedo_weight : 1.0F) / static_cast<float>(group.views.size()),
      .encode_srgb = gaussians.layout.appearance == Appearance::Transfer};
  launch_loss(rendered, of_albedo ? group.albedo_targets.data() : group.color_targets.data(), gradient, w, loss,
              stream);
}

void TrainStep::Impl::losses(const Group& group, const WorkspaceView& w) {
  check(cudaMemsetAsync(w.loss, 0, sizeof(float) * kMaxBatch, stream), "clearing the losses");
  picture_loss(w.color, group, false, w.color_gradient, w);
  if (albedo()) picture_loss(w.albedo, group, true, w.albedo_gradient, w);
}

void TrainStep::Impl::update(const WorkspaceView& w) {
  const AdamOptions adam{.beta1 = options.beta1,
                         .beta2 = options.beta2,
                         .epsilon = options.epsilon,
                         .learning_rate = learning_rate.data(),
                         .active_channels = options.active_channels};
  const OptimizerState state{.first = first.data(), .second = second.data(), .steps = steps.data()};
  launch_update(gaussians, w, project_options(false), state, adam, stream);
}

void TrainStep::Impl::enqueue_forward(const WorkspaceView& w, bool rebuild) {
  launch_project(gaussians, w, project_options(rebuild), stream);
  if (rebuild) {
    launch_sort(w, stream);
    read_pair_count(w);
  }
  launch_blend_forward(gaussians, w, stream);
}

void TrainStep::Impl::drop_graphs() {
  for (auto& group : groups) {
    group->rebuild_graph.reset();
    group->reuse_graph.reset();
  }
}

/// Grows the pair buffers when an earlier build did not fit. The count is of a build long done, or not there yet.
void TrainStep::Impl::grow_if_needed(Group& group) {
  if (*host_pair_count > pair_capacity) {
    check(cudaStreamSynchronize(stream), "waiting to grow");
    pair_capacity = with_room(*host_pair_count);
    for (auto& other : groups) other->lists_built = false;
    drop_graphs();
  }
  const std::size_t entries = std::size_t{pair_capacity} + 3;  // they are read four at a time
  if (keeps_lists() && group.entries.size() < entries) {
    check(cudaStreamSynchronize(stream), "waiting to grow");
    group.entries.resize(entries);
    group.rebuild_graph.reset();
    group.reuse_graph.reset();
    group.lists_built = false;
  }
}

/// Sizes the pair buffers for a group's first build: the only wait.
void TrainStep::Impl::size_lists(Group& group) {
  launch_project(gaussians, workspace_for(group), project_options(true), stream);
  read_pair_count(workspace_for(group));
  check(cudaStreamSynchronize(stream), "sizing the tile lists");
  const bool alone = std::none_of(groups.begin(), groups.end(), [](const auto& other) { return other->lists_built; });
  if (*host_pair_count < pair_capacity / 4 && alone) pair_capacity = with_room(*host_pair_count);
  grow_if_needed(group);
}

void TrainStep::Impl::enqueue_training(const Group& group, const WorkspaceView& w) {
  losses(group, w);
  launch_blend_backward(gaussians, w, stream);
  update(w);
}

void TrainStep::Impl::run(Group& group, bool train) {
  grow_if_needed(group);
  const bool rebuild = !group.lists_built || group.steps >= std::max(1, options.rebuild_interval);
  if (!group.lists_built) size_lists(group);
  group.lists_built = true;
  const WorkspaceView w = workspace_for(group);
  const auto enqueue = [&] {
    enqueue_forward(w, rebuild);
    if (train) enqueue_training(group, w);
  };
  if (!options.use_graph || !train) {
    enqueue();
  } else {
    (rebuild ? group.rebuild_graph : group.reuse_graph).launch(stream, enqueue);
  }
  group.steps = rebuild ? 1 : group.steps + 1;
  last = &group;
}

std::vector<TrainStep::StageTime> TrainStep::time_stages(std::size_t index, int repeats) {
  Group& group = *impl_->groups.at(index);
  Impl& impl = *impl_;
  impl.run(group, impl.options.training);
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

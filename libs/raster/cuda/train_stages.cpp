// The stages of a training step, and how long each of them takes.
#include <algorithm>
#include <array>
#include <functional>
#include <utility>

#include "raster/cuda/train_step.h"

namespace splatbus::raster::cuda {

/// Pages come one by one; all arrays grow a quarter at a time.
int TrainStep::index_capacity() {
  if (!gaussians_.has_pages()) return static_cast<int>(gaussians_.stride);
  if (gaussians_.count > page_indices_) page_indices_ = gaussians_.count + gaussians_.count / 4;
  return page_indices_;
}

WorkspaceView TrainStep::workspace_for(ViewBatch& batch) {
  const bool transfer = gaussians_.layout.appearance == Appearance::Transfer;
  const int capacity = index_capacity();
  const bool grown =
      workspace_.reserve({.count = gaussians_.count,
                          .capacity = capacity,
                          .batch = batch.batch,
                          .width = batch.width,
                          .height = batch.height,
                          .range_count = gaussians_.range_count,
                          .range_capacity = static_cast<int>(static_cast<unsigned>(capacity) >> kPageShift),
                          .albedo = options_.albedo_weight > 0.0F && transfer && batch.targets().albedo,
                          .depth = options_.depth_weight > 0.0F && batch.targets().depth,
                          .training = options_.training,
                          .isect_capacity = batch.isect_capacity()});
  if (grown) invalidate_graphs();
  batch.follow_model(gaussians_, stream());
  WorkspaceView w = workspace_.view();
  batch.bind(w);
  return w;
}

/// The only wait.
void TrainStep::size_isects(ViewBatch& batch) {
  const WorkspaceView w = workspace_for(batch);
  batch.copy_tables(w.counts, stream());
  launch_project(gaussians_, w, options_.project, stream());
  std::uint32_t isects = 0;
  check(cudaMemcpyAsync(&isects, &w.counts->isects, sizeof(isects), cudaMemcpyDeviceToHost, stream()),
        "reading the number of intersections");
  check(cudaStreamSynchronize(stream()), "counting intersections");
  batch.size_by(isects);
}

void TrainStep::enqueue_forward(const ViewBatch& batch, const WorkspaceView& w) {
  batch.copy_tables(w.counts, stream());
  launch_project(gaussians_, w, options_.project, stream());
  launch_sort(w, stream());
  launch_blend_forward(gaussians_, w, stream());
}

void TrainStep::picture_loss(const float* rendered, const ViewBatch& batch, bool of_albedo, float* gradient,
                             const WorkspaceView& w) {
  const LossKernelOptions loss{.masks = batch.masks(),
                               .ssim_weight = options_.ssim_weight,
                               .weight = (of_albedo ? options_.albedo_weight : 1.0F) / static_cast<float>(batch.batch),
                               .encode_srgb = gaussians_.layout.appearance == Appearance::Transfer};
  launch_loss(rendered, of_albedo ? batch.albedo_targets() : batch.color_targets(), gradient, w, loss, stream());
}

void TrainStep::losses(const ViewBatch& batch, const WorkspaceView& w) {
  picture_loss(w.color, batch, false, w.color_gradient, w);
  if (w.albedo != nullptr) picture_loss(w.albedo, batch, true, w.albedo_gradient, w);
  if (w.depth == nullptr) return;
  const float values = static_cast<float>(batch.batch) * static_cast<float>(w.width) * static_cast<float>(w.height);
  launch_depth_loss(batch.depth_targets(), batch.masks(), w, options_.depth_weight / values, stream());
}

void TrainStep::update(const ViewBatch& batch, const WorkspaceView& w) {
  const AdamOptions adam_options{.beta1 = options_.beta1,
                                 .beta2 = options_.beta2,
                                 .epsilon = options_.epsilon,
                                 .learning_rate = learning_rate_.data(),
                                 .active_channels = options_.active_channels,
                                 .unit_albedo = options_.unit_albedo,
                                 .lr_half_life_steps = options_.lr_half_life_steps,
                                 .lr_min_factor = options_.lr_min_factor,
                                 .loss_limits = options_.lr_recovery ? batch.loss_limits() : nullptr};
  launch_update(gaussians_, w, options_.project, adam_.view(), adam_options, adam_.statistics(), stream());
  launch_bounds(gaussians_, w, stream());
}

std::vector<TrainStep::StageTime> TrainStep::time_stages(std::span<const TrainView> views, int repeats) {
  options_.training ? step(views) : forward(views);
  retire(true);
  ViewBatch& batch = batch_for(views);
  const WorkspaceView w = workspace_for(batch);
  const std::array<std::pair<const char*, std::function<void()>>, 6> stages = {{
      {"project_and_list",
       [&] {
         launch_clear_counts(w, stream());
         launch_project(gaussians_, w, options_.project, stream());
       }},
      {"sort", [&] { launch_sort(w, stream()); }},
      {"blend_forward", [&] { launch_blend_forward(gaussians_, w, stream()); }},
      {"loss", [&] { losses(batch, w); }},
      {"blend_backward", [&] { launch_blend_backward(gaussians_, w, stream()); }},
      {"update", [&] { update(batch, w); }},
  }};
  constexpr std::size_t kForwardStages = 3;
  const std::size_t count = options_.training ? stages.size() : kForwardStages;
  std::array<cudaEvent_t, stages.size() + 1> marks{};
  for (cudaEvent_t& mark : marks) check(cudaEventCreate(&mark), "making an event");
  std::array<std::vector<float>, stages.size()> samples;
  for (int k = 0; k < repeats; ++k) {
    check(cudaEventRecord(marks[0], stream()), "timing");
    for (std::size_t s = 0; s < count; ++s) {
      stages[s].second();
      check(cudaEventRecord(marks[s + 1], stream()), "timing");
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

// The stages of a training step, and how long each of them takes.
#include <algorithm>
#include <array>
#include <functional>
#include <utility>

#include "raster/cuda/train_step.h"

namespace splatbus::raster::cuda {

WorkspaceView TrainStep::workspace_for(ViewBatch& batch) {
  const bool transfer = gaussians_.layout.appearance == Appearance::Transfer;
  const bool grown = workspace_.reserve({.count = gaussians_.count,
                                         .capacity = gaussians_.has_pages() ? 0 : static_cast<int>(gaussians_.stride),
                                         .batch = batch.batch,
                                         .width = batch.width,
                                         .height = batch.height,
                                         .range_count = gaussians_.range_count,
                                         .range_capacity = gaussians_.range_count + gaussians_.range_count / 4,
                                         .list_capacity = batch.list_capacity(),
                                         .albedo = options_.albedo_weight > 0.0F && transfer && batch.targets().albedo,
                                         .depth = options_.depth_weight > 0.0F && batch.targets().depth,
                                         .training = options_.training,
                                         .mask = options_.mask_opacity > 0.0F && batch.targets().depth,
                                         .isect_capacity = batch.isect_capacity()});
  if (grown) invalidate_graphs();
  batch.follow_model(gaussians_, stream());
  WorkspaceView w = workspace_.view();
  batch.bind(w);
  return w;
}

/// The only wait.
void TrainStep::size_lists(ViewBatch& batch) {
  StepCounts counts{};
  WorkspaceView w = workspace_for(batch);
  batch.copy_tables(w.counts, stream());
  for (;;) {
    launch_project(gaussians_, w, options_.project, stream());
    check(cudaMemcpyAsync(&counts, w.counts, sizeof(counts), cudaMemcpyDeviceToHost, stream()),
          "reading the number of intersections");
    check(cudaStreamSynchronize(stream()), "counting intersections");
    batch.size_by(counts.isects, counts.seen);
    if (counts.seen <= w.list_capacity) return;
    w = workspace_for(batch);
    launch_clear_counts(w, stream());
  }
}

void TrainStep::enqueue_forward(const ViewBatch& batch, const WorkspaceView& w) {
  batch.copy_tables(w.counts, stream());
  launch_project(gaussians_, w, options_.project, stream());
  launch_sort(w, stream());
  launch_blend_forward(gaussians_, w, stream());
}

void TrainStep::picture_loss(const float* rendered, const ViewBatch& batch, bool of_albedo, float* gradient,
                             const WorkspaceView& w) {
  const LossKernelOptions loss{.masks = masks_of(batch, w),
                               .ssim_weight = options_.ssim_weight,
                               .weight = (of_albedo ? options_.albedo_weight : 1.0F) / static_cast<float>(batch.batch),
                               .encode_srgb = gaussians_.layout.appearance == Appearance::Transfer};
  launch_loss(rendered, of_albedo ? batch.albedo_targets() : batch.color_targets(), gradient, w, loss, stream());
}

ViewMasks TrainStep::masks_of(const ViewBatch& batch, const WorkspaceView& w) {
  return {.of_views = batch.masks(), .plane = w.mask};
}

void TrainStep::losses(const ViewBatch& batch, const WorkspaceView& w) {
  if (w.mask != nullptr) {
    launch_mask_unmodelled(batch.depth_targets(), batch.masks(), options_.mask_opacity, batch.has_far_field(), w,
                           stream());
  }
  picture_loss(w.color, batch, false, w.color_gradient, w);
  if (w.albedo != nullptr) picture_loss(w.albedo, batch, true, w.albedo_gradient, w);
  if (w.depth == nullptr) return;
  const float values = static_cast<float>(batch.batch) * static_cast<float>(w.width) * static_cast<float>(w.height);
  launch_depth_loss(batch.depth_targets(), masks_of(batch, w), w, options_.depth_weight / values, stream());
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

std::size_t TrainStep::page_count() const {
  return (static_cast<std::size_t>(gaussians_.count) >> gaussians_.page_shift) + 1;
}

/// Of a step that is enqueued; the host's copy is there when it is done.
void TrainStep::look_at_pages(const ViewBatch& batch, const WorkspaceView& w, std::size_t slot) {
  const std::size_t pages = page_count(), sums = static_cast<std::size_t>(batch.batch) * pages;
  if (sums > look_room_) {
    // Looks that are on their way lie where they were.
    retire(true);
    look_room_ = sums + sums / 4;
    sums_.resize(look_room_);
    host_sums_.resize(ViewBatch::kStepsInFlight * look_room_);
  }
  const LookPictures pictures{.targets = batch.color_targets(),
                              .masks = masks_of(batch, w),
                              .encode_srgb = gaussians_.layout.appearance == Appearance::Transfer};
  launch_page_looks(gaussians_, w, pictures, sums_.data(), static_cast<int>(pages), stream());
  check(cudaMemcpyAsync(host_sums_.data() + slot * look_room_, sums_.data(), sums * sizeof(PageSums),
                        cudaMemcpyDeviceToHost, stream()),
        "reading what views show of pages");
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

#include "trainer/cuda/step_queue.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <stdexcept>
#include <utility>

namespace splatbus::trainer {

namespace {

constexpr std::size_t kMaxGroups = 32;

// Lists grow with every try; what does not fit by then never will.
constexpr int kMostTries = 8;

raster::cuda::TrainView train_view(const TrainingView& view) {
  return {.view = {.camera = view.camera, .scene = &view.scene},
          .color = view.color.data(),
          .albedo = view.albedo.empty() ? nullptr : view.albedo.data(),
          .depth = view.depth.empty() ? nullptr : view.depth.data()};
}

}  // namespace

StepQueue::~StepQueue() {
  cudaStreamSynchronize(train_.stream());
}

std::vector<StepQueue::Part> StepQueue::split(std::span<const TrainingViewPtr> views) {
  std::map<std::pair<std::uint32_t, std::uint32_t>, std::vector<TrainingViewPtr>> by_size;
  for (const TrainingViewPtr& view : views) {
    if (view->memory != Device::Cuda) throw std::invalid_argument("a picture is not in device memory");
    by_size[{view->camera.width, view->camera.height}].push_back(view);
  }
  std::vector<Part> parts;
  for (const auto& [size, of_size] : by_size) {
    for (std::size_t first = 0; first < of_size.size(); first += raster::cuda::kMaxBatch) {
      const std::size_t end = std::min(of_size.size(), first + raster::cuda::kMaxBatch);
      parts.push_back({.views = {of_size.begin() + static_cast<std::ptrdiff_t>(first),
                                 of_size.begin() + static_cast<std::ptrdiff_t>(end)}});
    }
  }
  return parts;
}

std::size_t StepQueue::enqueue(std::span<const TrainingViewPtr> views) {
  std::size_t enqueued = 0;
  for (Part& part : split(views)) enqueued += enqueue(std::move(part));
  if (enqueued > 0) parts_.back().ends_step = true;
  return enqueued;
}

void StepQueue::enqueue_repeats() {
  while (!repeats_.empty()) {
    Part part = std::move(repeats_.front());
    repeats_.pop_front();
    enqueue(std::move(part));
  }
}

std::size_t StepQueue::enqueue(Part part) {
  std::vector<raster::cuda::TrainView> views;
  for (const TrainingViewPtr& view : part.views) views.push_back(train_view(*view));
  if (parts_.empty()) busy_since_ = Clock::now();
  parts_.push_back(std::move(part));
  try {
    train_.step(group_for(views));
    return views.size();
  } catch (...) {
    cudaStreamSynchronize(train_.stream());  // a piece of it may be on its way, and reads the pictures
    parts_.pop_back();
    throw;
  }
}

/// The step that it would have ended has ended before.
void StepQueue::give_up(const Part& part) {
  if (part.ends_step) ++ended_steps_;
}

/// The group of these views' size, with them in it.
std::size_t StepQueue::group_for(std::span<const raster::cuda::TrainView> views) {
  const Camera& camera = views[0].view.camera;
  const GroupKey key{camera.width, camera.height, views.size()};
  if (const auto found = groups_.find(key); found != groups_.end()) {
    train_.renew_group(found->second, views);
    return found->second;
  }
  if (groups_.size() >= kMaxGroups) {
    train_.clear_groups();
    groups_.clear();
  }
  const std::size_t group = train_.add_group(views);
  groups_[key] = group;
  return group;
}

StepReport StepQueue::collect(bool wait) {
  StepReport sum;
  const auto reports = train_.finished(wait);
  for (const auto& report : reports) {
    Part part = std::move(parts_.front());
    parts_.pop_front();
    if (!report.changed) {
      repeat(std::move(part));
      continue;
    }
    sum += {.steps = part.ends_step ? 1U : 0U, .views = part.views.size(), .loss = report.loss};
  }
  sum.steps += std::exchange(ended_steps_, 0);
  if (!reports.empty()) {
    const Clock::time_point now = Clock::now();
    sum.seconds = std::chrono::duration<double>(now - std::exchange(busy_since_, now)).count();
  }
  return sum;
}

void StepQueue::repeat(Part part) {
  if (++part.tries < kMostTries) return repeats_.push_back(std::move(part));
  give_up(part);
  if (!std::exchange(warned_lists_, true)) {
    spdlog::error("optimizer: Gaussians cover more tiles of pictures than can be listed: such steps are left out");
  }
}

}  // namespace splatbus::trainer

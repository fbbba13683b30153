// What an Optimizer takes out of its model between steps, and what it adds.

#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>

#include "trainer/optimizer.h"

namespace splatbus::trainer {

namespace {

using namespace std::chrono_literals;
using model::InsertResult;

// A change of structure costs every reader: not for a handful that makes no difference ...
constexpr std::size_t kWorthwhilePart = 500;  // of the model
// ... or that can wait a little.
constexpr auto kCarvePeriod = 500ms;

float logit(float opacity) {
  return opacity > 0 ? std::log(opacity / (1.0F - opacity)) : -1e30F;
}

/// Far apart for neighbouring steps.
std::uint64_t seed_of(std::uint64_t seed, std::uint64_t step) {
  return (seed << 32U) + step + 1;
}

}  // namespace

void Optimizer::list_scales() {
  std::vector<kernels::FrameScale> scales;
  if (newest_view_) {
    for (const auto& [id, object] : newest_view_->scene.objects) {
      if (object.scale != 1) scales.push_back({id, std::log(object.scale)});
    }
  }
  scales_.assign(std::span<const kernels::FrameScale>(scales));
  step_->stream().wait();
}

void Optimizer::search_prunable() {
  const PruneOptions& options = options_.prune;
  dead_.resize(store_.view().count);
  dead_counts_.clear();
  list_scales();
  kernels::mark_prunable(step_->stream(), gaussians(), frame_scales(), created_step_.data(),
                         {.step = store_.step(),
                          .min_age_steps = options.min_age_steps,
                          .min_opacity_logit = logit(options.min_opacity),
                          .max_log_scale = std::log(options.max_scale_m)},
                         dead_.data(), dead_counts_.data());
  searched_after_ = launched_;
}

void Optimizer::prune_found(bool waited) {
  if (!searched_after_ || !(waited || store_.device() == Device::Cpu || done_ > *searched_after_)) return;
  searched_after_.reset();
  // Not on the steps' stream, where more of them are under way.
  const device::StreamView stream = device::thread_stream(store_.device());
  kernels::PruneCounts counts;
  device::copy(stream, &counts, dead_counts_.data(), sizeof(counts));
  stream.wait();
  if (counts.not_finite == 0 && std::size_t{counts.removed} * kWorthwhilePart < store_.count()) return;
  collect(true);
  wait_for_values();
  remove_dead();
  if (counts.not_finite > 0) {
    spdlog::warn("optimizer: Gaussians that were not finite were removed at step {}", store_.step());
  }
}

void Optimizer::remove_dead() {
  follow(store_.remove(dead_.data()).moves);
  follow(store_.merge());
}

void Optimizer::look_at(std::span<const TrainingViewPtr> pictures) {
  const kernels::CarveLimits limits{.votes = options_.carve.votes,
                                    .min_opacity_logit = logit(options_.prune.min_opacity)};
  for (const TrainingViewPtr& view : pictures) {
    // An input camera may stand in a wall whose back faces are not drawn: it would see free space.
    if (view->camera.role != CameraRole::Reference) continue;
    carver_.look(view, gaussians(), store_.device_bounds(), limits, launched_);
  }
}

bool Optimizer::carve() {
  const std::size_t found = carver_.carvable(done_);
  const auto now = std::chrono::steady_clock::now();
  const bool wait = found * kWorthwhilePart < store_.count() && now - last_carved_ < kCarvePeriod;
  if (found == 0 || wait) return false;
  settle();
  dead_.resize(store_.view().count);
  const std::size_t gone = carver_.mark(gaussians(), options_.carve.votes, dead_.data());
  if (gone == 0) return false;
  remove_dead();
  carved_ += gone;
  last_carved_ = now;
  spdlog::debug("optimizer: {} Gaussians stood in free space at step {}", gone, store_.step());
  return true;
}

void Optimizer::densify() {
  settle();
  const kernels::ScreenStatistics statistics = step_->statistics();
  if (statistics.steps == nullptr || store_.count() == 0) return;
  const device::StreamView stream = step_->stream();
  const kernels::PagedGaussians before = gaussians();
  device::Buffer<std::uint32_t> chosen(stream, std::size_t{before.range_count} * kPageLanes);
  const std::size_t dense =
      kernels::list_dense(stream, before, statistics, options_.densify.gradient_threshold, chosen.data());
  step_->clear_statistics();
  const std::size_t count = std::min(dense, store_.room());
  if (count == 0) return;
  // The originals may move: who they are follows them.
  PerIndex<std::uint32_t> copy_of(stream);
  copy_of.grow(store_.view().count);
  kernels::number_originals(stream, chosen.data(), static_cast<std::uint32_t>(count), copy_of.data());
  stream.wait();
  const InsertResult copies = store_.duplicate(chosen.data(), count);
  copy_of.grow(store_.view().count);
  kernels::move_values(stream, copy_of.data(), copies.moves);
  list_scales();
  kernels::split(stream, gaussians(), frame_scales(), copy_of.data(), copies.added,
                 {.max_clone_log_scale = std::log(options_.densify.clone_max_scale_m),
                  .seed = seed_of(options_.seed, store_.step())});
  follow(copies.moves);
  store_.refresh_bounds();
}

}  // namespace splatbus::trainer

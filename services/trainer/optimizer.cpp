#include "trainer/optimizer.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "bus/error.h"
#include "trainer/size_limit.h"

namespace splatbus::trainer {

namespace {

using model::Moves;

constexpr std::uint64_t kLimitPeriod = 4;  // steps

/// Indices that were nobody's, or somebody else's, under the ranges before: the end of pages that grew, and new pages.
std::vector<IndexRange> fresh_ranges(std::span<const IndexRange> before, std::span<const IndexRange> now) {
  std::vector<IndexRange> fresh;
  auto old = before.begin();
  for (const IndexRange& range : now) {
    while (old != before.end() && old->first < range.first) ++old;
    const std::uint32_t kept = old != before.end() && old->first == range.first ? old->count : 0;
    if (range.count > kept) fresh.push_back({range.first + kept, range.count - kept, range.frame_id});
  }
  return fresh;
}

}  // namespace

StepReport& StepReport::operator+=(const StepReport& later) {
  const std::size_t all = views + later.views;
  const auto mean = [&](double before, double after) {
    return (before * static_cast<double>(views) + after * static_cast<double>(later.views)) / static_cast<double>(all);
  };
  if (all > 0) {
    loss = mean(loss, later.loss);
    masked_share = mean(masked_share, later.masked_share);
  }
  steps += later.steps;
  views = all;
  seconds += later.seconds;
  looks.insert(looks.end(), later.looks.begin(), later.looks.end());
  return *this;
}

float active_share(std::span<const raster::PageLook> pages, const model::PageTable& table) {
  double pairs = 0, active = 0;
  for (const raster::PageLook& page : pages) {
    pairs += page.pairs;
    if (table.entry(page.page).now.state != model::PageState::Frozen) active += page.pairs;
  }
  return pairs > 0 ? static_cast<float>(active / pairs) : 1.0F;
}

std::unique_ptr<GradientStep> make_gradient_step(model::PageStore& store, const Options& options) {
  if (store.device() == Device::Cpu) return make_cpu_step(store, options);
#ifdef SPLATBUS_HAVE_CUDA
  return make_cuda_step(store, options);
#else
  throw bus::Error("this build cannot train a model in device memory");
#endif
}

Optimizer::Optimizer(model::PageStore& store, const Options& options, const StepMaker& make_step)
    : store_(store),
      step_(make_step(store, options)),
      visibilities_(store, step_->stream()),
      fresh_(step_->stream()),
      created_step_(step_->stream()),
      dead_(step_->stream()),
      dead_counts_(step_->stream(), 1),
      scales_(step_->stream()),
      carver_(step_->stream()) {
  // An adopted model is taken for old: its average is settled.
  const GaussiansView view = store.view();
  created_step_.grow(view.count);
  carver_.follow(view.count, fresh_, {});
  ranges_.assign(view.ranges.begin(), view.ranges.end());
  set_options(options);
}

Optimizer::~Optimizer() = default;

void Optimizer::set_options(const Options& options) {
  options_ = options;
  step_->set_options(options_);
  if (store_.frozen_pages() > 0) settle();
  thaw_unseen();
}

void Optimizer::thaw_unseen() {
  if (options_.freeze.enabled || store_.frozen_pages() == 0) return;
  // Nobody would ever see that one of them has to train again.
  std::vector<std::uint32_t> pages;
  for (const IndexRange& range : store_.view().ranges) pages.push_back(range.first >> kPageShift);
  store_.thaw(pages);
  follow({});
}

kernels::PagedGaussians Optimizer::gaussians() const {
  return {.memory = store_.memory(),
          .channels = static_cast<std::uint32_t>(store_.layout().channels()),
          .active_channels = static_cast<std::uint32_t>(active_channels(options_)),
          .ranges = store_.device_ranges(),
          .range_count = static_cast<std::uint32_t>(store_.view().ranges.size())};
}

float Optimizer::ema_decay() const {
  const double covered_steps =
      store_.optimizer_s() > 0 ? options_.ema_s * static_cast<double>(store_.step()) / store_.optimizer_s() : 0;
  const double of_time = covered_steps > 1 ? 1 - 1 / covered_steps : 0;
  return std::max(options_.ema_decay, static_cast<float>(of_time));
}

bool Optimizer::apply(const Commands& commands, std::span<const std::uint64_t> needed) {
  for (const VisibilityCommand& relit : commands.visibilities) visibilities_.take(relit, needed);
  bool changed = false;
  for (const InsertBatch& batch : commands.inserts) {
    if (store_.holds(batch.epoch, batch.batch)) continue;
    if (!changed) settle();
    follow(store_.insert(batch.rows, batch.count, batch.scene, batch.epoch, batch.batch).moves);
    changed = true;
  }
  if (options_.carve.enabled) look_at(commands.pictures);
  return carve() || changed;
}

void Optimizer::restructure(const std::function<void()>& change) {
  settle();
  change();
  follow({}, 0);
  thaw_unseen();  // what comes back from a world may be frozen
}

void Optimizer::follow(const Moves& moves, std::uint64_t created_step) {
  const GaussiansView view = store_.view();
  const std::vector<IndexRange> fresh = fresh_ranges(ranges_, view.ranges);
  ranges_.assign(view.ranges.begin(), view.ranges.end());
  created_step_.grow(view.count);
  fresh_.assign(std::span(fresh));
  kernels::set_values(step_->stream(), created_step_.data(), fresh_.data(), static_cast<std::uint32_t>(fresh.size()),
                      created_step);
  kernels::move_values(step_->stream(), created_step_.data(), moves);
  carver_.follow(view.count, fresh_, moves);
  visibilities_.follow(
      {.memory = store_.memory(), .ranges = fresh_.data(), .range_count = static_cast<std::uint32_t>(fresh.size())},
      moves);
  step_->follow(fresh, moves);
  wait_for_values();  // the moves are gone with the next change
}

StepReport Optimizer::step(std::span<const TrainingViewPtr> views) {
  if (views.empty() || store_.count() == 0) return std::exchange(report_, {});
  for (const TrainingViewPtr& view : views) {
    if (!newest_view_ || view->scene.version >= newest_view_->scene.version) newest_view_ = view;
  }
  std::vector<PairedView> paired;
  paired.reserve(views.size());
  for (const TrainingViewPtr& view : views) paired.push_back({view, visibilities_.find(view->scene)});
  step_->step(paired);
  launched_ += 1;
  collect(false);
  store_.add_step(views.size(), std::exchange(unbooked_s_, 0.0));
  const std::uint64_t step = store_.step();
  if (options_.most_size > 0 && step % kLimitPeriod == 0) limit_sizes(views);
  average();
  if (options_.prune.enabled && step % options_.prune.interval_steps == 0 && !searched_after_) search_prunable();
  prune_found(false);
  if (options_.densify.enabled && step % options_.densify.interval_steps == 0) densify();
  if (options_.freeze.enabled) rest_settled();
  return std::exchange(report_, {});
}

void Optimizer::limit_sizes(std::span<const TrainingViewPtr> views) {
  kernels::Eyes eyes;
  for (const TrainingViewPtr& view : views.first(std::min<std::size_t>(views.size(), kernels::Eyes::kMost))) {
    const glm::vec3& eye = view->camera.world_from_camera.translation;
    eyes.x_m[eyes.count] = eye.x;
    eyes.y_m[eyes.count] = eye.y;
    eyes.z_m[eyes.count++] = eye.z;
  }
  kernels::limit_sizes(step_->stream(), gaussians(), eyes, options_.most_size);
}

StepReport Optimizer::finish() {
  settle();
  store_.add_time(std::exchange(unbooked_s_, 0.0));
  return std::exchange(report_, {});
}

void Optimizer::publish(const bus::Publisher& publisher) {
  if (store_.device() != Device::Cpu) {
    wait_for_values();
    store_.refresh_bounds();
  }
  store_.publish(publisher);
}

void Optimizer::collect(bool wait) {
  const StepReport done = step_->finished(wait);
  if (options_.freeze.enabled) freezer_.see(store_, done.looks);
  done_ += done.steps;
  unbooked_s_ += done.seconds;
  report_ += done;
}

void Optimizer::settle() {
  collect(true);
  wait_for_values();
  carver_.settled();
  prune_found(true);
}

void Optimizer::average() {
  const float settled = 1.0F - std::pow(ema_decay(), static_cast<float>(kernels::kStripes));
  kernels::update_average(step_->stream(), gaussians(), created_step_.data(), store_.step(), settled);
}

void Optimizer::rest_settled() {
  if (!freezer_.due(store_)) return;
  const std::vector<float> movements =
      kernels::page_movements(step_->stream(), gaussians(), options_.layout.appearance);
  const Freezer::Change change = freezer_.decide(store_, options_.freeze, movements);
  if (change.freeze.empty() && change.thaw.empty()) return;
  settle();
  if (store_.device() != Device::Cpu) store_.refresh_bounds();  // the change hands the host's to the device
  store_.freeze(change.freeze);
  store_.thaw(change.thaw);
  follow({});
  spdlog::debug("optimizer: {} pages froze and {} thawed at step {}", change.freeze.size(), change.thaw.size(),
                store_.step());
}

}  // namespace splatbus::trainer

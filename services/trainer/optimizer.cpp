#include "trainer/optimizer.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "bus/error.h"

namespace splatbus::trainer {

namespace {

using namespace std::chrono_literals;
using model::InsertResult;
using model::Moves;

// A change of structure costs every reader: not for a handful that makes no difference ...
constexpr std::size_t kWorthwhilePart = 500;  // of the model
// ... or that can wait a little.
constexpr auto kCarvePeriod = 500ms;

float logit(float opacity) {
  return opacity > 0 ? std::log(opacity / (1.0F - opacity)) : -1e30F;
}

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

/// Far apart for neighbouring steps.
std::uint64_t seed_of(std::uint64_t seed, std::uint64_t step) {
  return (seed << 32U) + step + 1;
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
  average();
  const std::uint64_t step = store_.step();
  if (options_.prune.enabled && step % options_.prune.interval_steps == 0 && !searched_after_) search_prunable();
  prune_found(false);
  if (options_.densify.enabled && step % options_.densify.interval_steps == 0) densify();
  if (options_.freeze.enabled) rest_settled();
  return std::exchange(report_, {});
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

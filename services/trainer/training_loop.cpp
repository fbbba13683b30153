// The optimizer's thread of the trainer: commands, steps and what is published of them.

#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <exception>
#include <optional>
#include <vector>

#include "bus/clock.h"
#include "bus/trace.h"
#include "trainer/seen_through.h"
#include "trainer/trainer.h"
#include "trainer/world_bytes.h"
#include "wire/model_generated.h"

namespace splatbus::trainer {

namespace {

using namespace std::chrono_literals;

constexpr auto kIdleWait = 20ms;
constexpr auto kModelPeriod = 250ms;
constexpr auto kRemoteModelPeriod = 5s;  // over tcp the planes ride in every message
constexpr auto kStatsPeriod = 1s;
constexpr auto kChangedStatsPeriod = 100ms;  // when cameras came or went, or the trainer stopped or goes on

constexpr double kWindow_s = 1.0;     // of optimizer time, for the pace
constexpr double kLossMemory = 0.95;  // a step

}  // namespace

void Progress::add(const StepReport& report) {
  if (report.steps == 0) return;
  recent_.push_back(report);
  recent_.back().looks = {};
  const auto masked = [](const StepReport& of) { return of.masked_share * static_cast<double>(of.views); };
  recent_masked_ += masked(report);
  recent_s_ += report.seconds;
  recent_steps_ += report.steps;
  recent_views_ += report.views;
  while (recent_.size() > 1 && recent_s_ - recent_.front().seconds >= kWindow_s) {
    recent_s_ -= recent_.front().seconds;
    recent_steps_ -= recent_.front().steps;
    recent_views_ -= recent_.front().views;
    recent_masked_ -= masked(recent_.front());
    recent_.pop_front();
  }
  const double memory = any_ ? std::pow(kLossMemory, static_cast<double>(report.steps)) : 0.0;
  loss_ = memory * loss_ + (1 - memory) * report.loss;
  any_ = true;
}

double Progress::steps_per_s() const {
  return recent_s_ > 0 ? static_cast<double>(recent_steps_) / recent_s_ : 0;
}

double Progress::views_per_s() const {
  return recent_s_ > 0 ? static_cast<double>(recent_views_) / recent_s_ : 0;
}

double Progress::masked_share() const {
  return recent_views_ > 0 ? std::max(0.0, recent_masked_ / static_cast<double>(recent_views_)) : 0;
}

void Trainer::optimize(const std::stop_token& stop) {
  try {
    while (!stop.stop_requested()) optimize_once();
  } catch (...) {
    optimizer_failure_ = std::current_exception();
    optimizer_failed_ = true;
  }
}

void Trainer::optimize_once() {
  refresh_options();
  const Commands commands = commands_.take();
  drop_untrue(commands.pictures);
  bool structure_changed = optimizer_->apply(commands, views_.versions());
  if (keeper_) {
    const std::uint64_t generation = store_->generation();
    keeper_->see(viewers_.places(bus::now_ns()));
    keeper_->turn([this](const auto& change) { optimizer_->restructure(change); });
    structure_changed |= store_->generation() != generation;
  }
  if (!commands.visibilities.empty()) pair_views();
  const bool steps = may_step();
  // What is published while nothing goes on is the end of all steps so far.
  if (!steps) structure_changed |= finish_steps();
  publish_due(structure_changed);
  if (steps) {
    train_step();
  } else {
    commands_.wait(kIdleWait);
  }
}

void Trainer::drop_untrue(std::span<const TrainingViewPtr> pictures) {
  for (const TrainingViewPtr& picture : pictures) {
    if (picture->camera.role != CameraRole::Reference) continue;
    const std::vector<TrainingViewPtr> kept = views_.kept_about(*picture);
    if (kept.empty()) continue;
    const auto seen = seen_through(device::thread_stream(picture->memory), *picture, kept);
    std::vector<std::uint32_t> untrue;
    for (std::size_t k = 0; k < kept.size(); ++k) {
      if (seen[k].differs()) untrue.push_back(kept[k]->kept_number);
    }
    views_.drop_kept(untrue);
    untrue_views_ += untrue.size();
  }
}

bool Trainer::finish_steps() {
  const std::uint64_t generation = store_->generation();
  take(optimizer_->finish());
  return store_->generation() != generation;
}

void Trainer::refresh_options() {
  if (!options_.refresh()) return;
  optimizer_->set_options(*options_);
  views_.set_keeps(optimizer_->options().kept_view_interval > 0);
  pair_views();
  with_depth_ = wants_depth(optimizer_->options());
}

void Trainer::pair_views() {
  const Options& options = optimizer_->options();
  const bool lit = options.pair_visibility && options.layout.appearance == Appearance::Transfer;
  views_.set_paired(lit ? std::optional(optimizer_->paired_versions()) : std::nullopt);
}

bool Trainer::may_step() const {
  const Options& options = optimizer_->options();
  if (options.paused || (options.run_until != 0 && store_->step() >= options.run_until)) return false;
  const bool inputs_count = options.input_view_interval > 0;
  return store_->count() > 0 &&
         (views_.any_to_train(CameraRole::Reference) || (inputs_count && views_.any_to_train(CameraRole::Input)));
}

void Trainer::take(const StepReport& report) {
  progress_.add(report);
  if (!optimizer_->options().views_by_loss) return sampler_.forget();
  for (const ViewLook& look : report.looks) sampler_.learn(key_of(*look.view), look.loss, look.active_share);
}

void Trainer::train_step() {
  const Options& options = optimizer_->options();
  const auto batch = sampler_.next_batch(views_, options.batch,
                                         {.input = options.input_view_interval, .kept = options.kept_view_interval});
  const bus::TracedWork work("train step", 0, batch.empty() ? 0 : batch.front()->scene.version);
  const std::uint64_t generation = store_->generation();
  take(optimizer_->step(batch));
  if (store_->generation() != generation) publish_due(true);
}

void Trainer::publish_due(bool structure_changed) {
  const auto now = Clock::now();
  const Options& options = optimizer_->options();
  const bool finished = options.run_until != 0 && store_->step() >= options.run_until;
  const State state{.finished_at = finished ? std::optional(store_->step()) : std::nullopt,
                    .paused = options.paused,
                    .cameras = views_.cameras_version()};
  const bool newly_finished = finished && state.finished_at != announced_.finished_at;
  const auto model_period = service_.bus->address().is_local() ? Clock::duration(kModelPeriod) : kRemoteModelPeriod;
  if (structure_changed || newly_finished || now - model_published_ >= model_period) {
    optimizer_->publish(publisher_);
    model_published_ = now;
  }
  const auto stats_period = state == announced_ ? Clock::duration(kStatsPeriod) : kChangedStatsPeriod;
  if (newly_finished || now - stats_published_ >= stats_period) {
    publish_stats(finished || options.paused);
    stats_published_ = now;
    announced_ = state;
  }
}

void Trainer::publish_stats(bool stopped) {
  const auto references = static_cast<std::uint32_t>(views_.count(CameraRole::Reference));
  const auto inputs = static_cast<std::uint32_t>(views_.count(CameraRole::Input));
  service_.counter("step", static_cast<double>(store_->step()));
  service_.counter("gaussians", static_cast<double>(store_->count()));
  service_.counter("steps_per_s", progress_.steps_per_s());
  service_.counter("loss", progress_.loss());
  service_.counter("carved", static_cast<double>(optimizer_->carved()));
  service_.counter("kept_views", static_cast<double>(views_.kept()));
  service_.counter("untrue_views", static_cast<double>(untrue_views_));
  service_.counter("unpaired_views", static_cast<double>(views_.unpaired()));
  if (stopped) {
    service_.detail("stopped at step " + std::to_string(store_->step()));
  } else if (store_->count() == 0) {
    service_.detail("waits for Gaussians");
  } else if (references + inputs == 0) {
    service_.detail("waits for training views");
  } else if (!views_.any_to_train(CameraRole::Reference) && !views_.any_to_train(CameraRole::Input)) {
    service_.detail("waits for the visibility of its views");
  } else {
    service_.detail("trains");
  }
  const WorldKeeper::Stats kept = keeper_ ? keeper_->stats() : WorldKeeper::Stats{};
  service_.counter("world_copy_s", kept.copy_s);
  publisher_.publish(topics::kTrainerStats, [&](auto& builder, auto header) {
    return wire::CreateTrainerStats(
        builder, header, store_->step(), store_->views(), store_->optimizer_s(), progress_.steps_per_s(),
        progress_.views_per_s(), progress_.loss(), store_->count(), store_->count() - store_->frozen_count(),
        references, inputs, stopped, host_copied_bytes_.load(), views_.unpaired(), store_->frozen_count(), kept.spilled,
        static_cast<std::uint32_t>(store_->page_count() - store_->frozen_pages()),
        static_cast<std::uint32_t>(store_->frozen_pages()), static_cast<std::uint32_t>(kept.spilled_pages),
        model_bytes(*store_), 0, kept.disk_bytes, static_cast<float>(progress_.masked_share()));
  });
}

}  // namespace splatbus::trainer

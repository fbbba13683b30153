// The optimizer's thread of the trainer: commands, steps and what is published of them.

#include <spdlog/spdlog.h>

#include <exception>
#include <optional>
#include <vector>

#include "trainer/trainer.h"
#include "wire/model_generated.h"

namespace splatbus::trainer {

namespace {

using namespace std::chrono_literals;

constexpr auto kIdleWait = 20ms;
constexpr auto kAfterError = 500ms;
constexpr auto kModelPeriod = 250ms;
constexpr auto kRemoteModelPeriod = 5s;  // over tcp the planes ride in every message
constexpr auto kStatsPeriod = 1s;
constexpr auto kChangedStatsPeriod = 100ms;  // when cameras came or went, or the trainer stopped or goes on

}  // namespace

void Trainer::optimize(const std::stop_token& stop) {
  while (!stop.stop_requested()) {
    try {
      optimize_once();
    } catch (const std::exception& error) {
      spdlog::error("optimizer: {}", error.what());
      failed_ = true;
      commands_.wait(kAfterError);
    }
  }
}

void Trainer::optimize_once() {
  refresh_options();
  Commands commands = commands_.take();
  bool structure_changed = false;
  try {
    structure_changed = optimizer_->apply(commands);
  } catch (...) {
    commands_.give_back(std::move(commands));
    throw;
  }
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

bool Trainer::finish_steps() {
  const std::uint64_t generation = store_->structure().generation;
  progress_.add(optimizer_->finish());
  return store_->structure().generation != generation;
}

void Trainer::refresh_options() {
  if (!options_.refresh()) return;
  optimizer_->set_options(*options_);
  with_depth_ = optimizer_->options().depth_weight > 0;
}

bool Trainer::may_step() const {
  const Options& options = optimizer_->options();
  if (options.paused || (options.run_until != 0 && store_->step() >= options.run_until)) return false;
  const bool inputs_count = options.input_view_interval > 0;
  return store_->count() > 0 &&
         (views_.any_to_train(CameraRole::Reference) || (inputs_count && views_.any_to_train(CameraRole::Input)));
}

void Trainer::train_step() {
  const Options& options = optimizer_->options();
  const auto batch = schedule_.next_batch(views_, options.batch, options.input_view_interval);
  const std::uint64_t generation = store_->structure().generation;
  progress_.add(optimizer_->step(batch));
  set_aside(optimizer_->take_left_out());
  if (store_->structure().generation != generation) publish_due(true);
}

void Trainer::set_aside(const std::vector<LeftOut>& views) {
  for (const auto& [view, why] : views) {
    const Camera& camera = view->camera;
    if (!views_.set_aside(*view)) continue;
    spdlog::warn("{} camera {}: pictures of {} x {} are left out of training, for there is no memory for them: {}",
                 camera.role == CameraRole::Input ? "input" : "reference", camera.id, camera.width, camera.height, why);
  }
}

void Trainer::publish_due(bool structure_changed) {
  if (structure_changed) views_.take_up();
  const auto now = Clock::now();
  const Options& options = optimizer_->options();
  const bool finished = options.run_until != 0 && store_->step() >= options.run_until;
  const State state{.finished_at = finished ? std::optional(store_->step()) : std::nullopt,
                    .paused = options.paused,
                    .cameras = views_.cameras_version()};
  const bool newly_finished = finished && state.finished_at != announced_.finished_at;
  const auto model_period = service_.bus->address().is_local() ? Clock::duration(kModelPeriod) : kRemoteModelPeriod;
  if (structure_changed || newly_finished || now - model_published_ >= model_period) {
    store_->publish(publisher_);
    model_published_ = now;
  }
  const auto stats_period = state == announced_ ? Clock::duration(kStatsPeriod) : kChangedStatsPeriod;
  if (newly_finished || now - stats_published_ >= stats_period) {
    publish_stats(finished || options.paused);
    publish_cells();
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
  service_.counter("refused_inserts", static_cast<double>(optimizer_->refused_inserts()));
  if (stopped) {
    service_.detail("stopped at step " + std::to_string(store_->step()));
  } else if (store_->count() == 0) {
    service_.detail("waits for Gaussians");
  } else if (references + inputs == 0) {
    service_.detail("waits for training views");
  } else {
    service_.detail("trains");
  }
  publisher_.publish(topics::kTrainerStats, [&](auto& builder, auto header) {
    return wire::CreateTrainerStats(builder, header, store_->step(), store_->views(), store_->optimizer_s(),
                                    progress_.steps_per_s(), progress_.views_per_s(), progress_.loss(), store_->count(),
                                    store_->count() - store_->structure().frozen, references, inputs, stopped,
                                    host_copied_bytes_.load());
  });
}

void Trainer::publish_cells() {
  std::vector<wire::CellStats> cells;
  for (const auto& [id, cell] : optimizer_->cells().cells()) {
    if (cell.seen) cells.emplace_back(id, cell.count, cell.loss, cell.movement);
  }
  if (cells.empty()) return;
  publisher_.publish(topics::kTrainerCells, [&](auto& builder, auto header) {
    const auto list = builder.CreateVectorOfStructs(cells);
    return wire::CreateTrainerCells(builder, header, store_->step(), list);
  });
}

}  // namespace splatbus::trainer

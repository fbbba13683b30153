#include "staged_training.h"

#include <fmt/format.h>

#include <stdexcept>
#include <utility>

#include "parameter_query.h"
#include "wire/system_generated.h"

namespace splatbus::cli {

namespace {

constexpr std::int64_t kRepeatNs = 3'000'000'000;  ///< what was asked for and has not come is asked for again
constexpr std::int64_t kShowNs = 1'000'000'000;

}  // namespace

StagedTraining::StagedTraining(const EvaluationSetup& setup, std::vector<Camera> held_out, const StopSignals& signals,
                               const std::function<void(const std::string&)>& show_state)
    : setup_(setup),
      show_state_(show_state),
      pipeline_(signals, setup.out / "services.log"),
      start_(context(), setup.enough_gaussians()),
      probes_(context(), std::move(held_out)),
      publisher_(context()) {
  pipeline_.start(plan_evaluation(setup, pipeline_.address(), true));
}

void StagedTraining::prepare() {
  ask_held_out();
  const auto ready = [&] {
    const PipelineState& state = pipeline_.state();
    return probes_.complete() && state.trainer.ready_references >= static_cast<std::uint32_t>(setup_.cameras) &&
           state.trainer.ready_inputs >= static_cast<std::uint32_t>(setup_.input_cameras) && state.grid.rounds >= 1 &&
           state.grid.batches_pending == 0 && pipeline_.has_gaussians() &&
           state.visibility_generation == live().published()->generation;
  };
  wait_until("the services and their first pictures", ready, [&] {
    const PipelineState& state = pipeline_.state();
    return fmt::format("references {}/{}, inputs {}/{}, held-out views {}/{}, {} Gaussians, {} batches pending{}",
                       state.trainer.ready_references, setup_.cameras, state.trainer.ready_inputs, setup_.input_cameras,
                       probes_.pictures().size(), probes_.cameras().size(), state.trainer.gaussians,
                       state.grid.batches_pending, state.visibility_generation == 0 ? ", no light visibility" : "");
  });
}

void StagedTraining::train_until(std::uint64_t step) {
  std::int64_t told_ns = 0;
  const auto ready = [&] {
    if (bus::now_ns() - told_ns > kRepeatNs) {
      send_control(publisher_, "trainer", {{"run_until", std::to_string(step)}, {"paused", "false"}});
      told_ns = bus::now_ns();
    }
    return state().trainer.step >= step;
  };
  wait_until(fmt::format("step {}", step), ready, [&] {
    const auto& trainer = state().trainer;
    return fmt::format("step {}/{}, {:.1f} steps/s, {} Gaussians, loss {:.4f}", trainer.step, step, trainer.steps_per_s,
                       trainer.gaussians, trainer.loss);
  });
  if (state().trainer.step != step) {
    throw std::runtime_error(fmt::format("the trainer stopped at step {} instead of {}", state().trainer.step, step));
  }
}

void StagedTraining::ask_held_out() {
  probes_.begin();
  asked_ns_ = bus::now_ns();
}

void StagedTraining::ask_again_for_missing() {
  if (probes_.complete() || bus::now_ns() - asked_ns_ <= kRepeatNs) return;
  for (std::size_t i = 0; i < probes_.cameras().size(); ++i) {
    if (!probes_.pictures().contains(i)) probes_.ask_again(i);
  }
  asked_ns_ = bus::now_ns();
}

void StagedTraining::wait_until(const std::string& what, const std::function<bool()>& condition,
                                const std::function<std::string()>& describe) {
  const std::int64_t end_ns = bus::now_ns() + static_cast<std::int64_t>(setup_.timeout_s * 1e9);
  std::int64_t shown_ns = 0;
  while (!condition()) {
    if (bus::now_ns() > end_ns) {
      throw std::runtime_error(fmt::format("{} did not come within {} s ({}); see {}", what, setup_.timeout_s,
                                           describe(), pipeline_.log().string()));
    }
    pipeline_.poll(std::chrono::milliseconds(20));
    start_.poll(std::chrono::milliseconds(0));
    probes_.poll(std::chrono::milliseconds(0), [](std::size_t, const ProbePicture&) {});
    ask_again_for_missing();
    if (bus::now_ns() - shown_ns > kShowNs) {
      show_state_(describe());
      shown_ns = bus::now_ns();
    }
  }
}

}  // namespace splatbus::cli

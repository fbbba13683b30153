#include <spdlog/spdlog.h>

#include <algorithm>
#include <utility>

#include "bus/clock.h"
#include "bus/log_sink.h"
#include "capture-bridge/capture_bridge.h"
#include "capture-bridge/nanoseconds.h"
#include "wire/model_generated.h"
#include "wire/sampling_topics.h"

// What becomes of the input pictures' rounds.
namespace splatbus::capture_bridge {

namespace {

constexpr std::int64_t kInputPatienceMaxNs = 30'000'000'000;
constexpr std::int64_t kExpanderPatienceNs = 1'500'000'000;

}  // namespace

void CaptureBridge::handle_grid_state(const wire::GridState& state, const bus::Message& message) {
  new_shares_.published(worker_.take_published());
  for (const NewShareWatch::Share& share :
       new_shares_.state(message.header().epoch(), state.rounds(), state.gaussians_inserted())) {
    if (share.rig_generation != 0) rigs_.inputs().note_new_share(share.rig_generation, share.of_samples);
  }
  if (state.rounds() > 0 || worker_.statistics().rounds == 0) return;
  // An expander that has seen no round has missed ours: it started later, or again.
  const std::int64_t now = bus::now_ns();
  for (auto& [viewer, rig] : rigs_.inputs().all()) {
    if (!rig.round.empty() && now - rig.submitted_ns > kExpanderPatienceNs) submit_round(rig, true);
  }
}

void CaptureBridge::update_rounds(std::int64_t now_ns) {
  const std::int64_t deadline = nanoseconds(options_->input_deadline_s);
  for (auto& [viewer, rig] : rigs_.inputs().all()) {
    const InputRound& round = rig.round;
    if (round.ready(now_ns, deadline)) submit_round(rig, false);
    rig.patience_ns = std::max(rig.patience_ns, deadline);
    if (round.missing().empty() || now_ns - rig.asked_ns < rig.patience_ns) continue;
    static bus::LogLimiter limiter;
    if (!round.empty() && limiter.allow()) {
      spdlog::warn("{} input frames have not come: asking again", round.missing().size());
    }
    rigs_.inputs().reissue_missing(rig, now_ns, rigs_.cameras());
    rig.patience_ns = std::min(2 * rig.patience_ns, kInputPatienceMaxNs);
  }
}

void CaptureBridge::submit_round(InputRig& rig, bool all) {
  rig.submitted_ns = bus::now_ns();
  InputJob job{.rig_generation = rig.round.rig_generation(), .options = options_->sampling};
  double share = 1;
  if (!all && rig.round.refreshes()) {
    job.views = rig.round.take_fresh();
    share = static_cast<double>(job.views.size()) / static_cast<double>(rig.round.cameras());
  } else {
    job.views = rig.round.take();
    // The cameras that are asked for later bring their own: a part of a dome is not to be sampled more finely, but for
    // what the viewer is about to see.
    share = std::max(rig.share_asked(), options_->glance_share);
  }
  // Nor is it where viewers share the cameras: each would have a model twice as fine as if he were alone, in half of
  // the time for it. One who is left alone has more again once he moves and is given cameras.
  share *= rig.share_owned(options_->dome.cameras);
  job.options.budget = static_cast<std::size_t>(static_cast<double>(job.options.budget) * share);
  submit(std::move(job));
}

void CaptureBridge::submit_glance(InputRig& rig) {
  const InputViewPointer glance = std::exchange(rig.glance, nullptr);
  // A round that is complete by it has it too. However few cameras the viewer has, this one is whole.
  if (!glance || options_->glance_share <= 0 || rig.round.ready(bus::now_ns(), INT64_MAX)) return;
  InputJob job{
      .views = {glance}, .rig_generation = rig.round.rig_generation(), .options = options_->sampling, .glance = true};
  job.options.budget = static_cast<std::size_t>(static_cast<double>(job.options.budget) * options_->glance_share);
  rig.submitted_ns = bus::now_ns();
  ++counters_.glances;
  submit(std::move(job));
}

void CaptureBridge::subscribe_to_helpers() {
  subscriber_
      .on(topics::kSamplingOffer,
          [this](const wire::SamplingOffer& offer, const bus::Message&) { sharing_.offered(*offer.header()); })
      .on(topics::kSamplingResult, [this](const wire::SamplingResult& result, const bus::Message& message) {
        const auto sampled = sharing_.answered(result, message, bus::now_ns());
        if (sampled) worker_.publish(sampled->job, sampled->result);
      });
}

void CaptureBridge::submit(InputJob job) {
  if (job.views.empty()) return;
  keep_one_size(job);
  const std::int64_t now = bus::now_ns();
  // A look ahead is small, and wanted at once: it takes no way over the bus.
  if (!job.glance && sharing_.is_anothers_turn(now)) {
    worker_.replace_by(job);
    return sharing_.hand(std::move(job), now);
  }
  sharing_.keep(job);
  worker_.submit(std::move(job));
}

/// Whoever has nothing to do takes what waits, whosever turn it was.
void CaptureBridge::share_rounds(std::int64_t now_ns) {
  for (InputJob& job : sharing_.take_back(now_ns)) {
    sharing_.keep(job);
    worker_.take_back(std::move(job));
  }
  while (sharing_.has_idle(now_ns)) {
    auto waiting = worker_.take_waiting();
    if (!waiting) return;
    sharing_.keep_not(*waiting);
    sharing_.hand(std::move(*waiting), now_ns);
  }
}

}  // namespace splatbus::capture_bridge

// How a trainer takes the place of another one, and leaves its own to the next.

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <limits>

#include "bus/clock.h"
#include "bus/error.h"
#include "bus/handover.h"
#include "bus/memory.h"
#include "trainer/trainer.h"

namespace splatbus::trainer {

namespace {

using namespace std::chrono_literals;

constexpr auto kViewsPatience = 10s;  // then it takes over with those that have come
constexpr auto kStandbyPeriod = 500ms;
constexpr int kRefusals = 8;  // of a model that may have been in the middle of a change

}  // namespace

bool Trainer::stand_by() {
  successor_ = service_.stands_by();
  if (!successor_) return true;
  bus::Subscriber before(service_.bus);
  before
      .on(topics::kModelPublished, [this](const wire::ModelPublished& published,
                                          const bus::Message& message) { look_at_model(published, message); })
      .on(topics::kTrainerStats, [this](const wire::TrainerStats& stats, const bus::Message&) {
        before_.views = std::size_t{stats.ready_references()} + stats.ready_inputs();
      });
  const auto turn = [&] {
    before.dispatch_all(0ms);
    if (before_.refusals >= kRefusals) throw bus::Error(before_failure_);
    // Of what the one before inserts, nothing: the expander repeats what no model has.
    commands_.post([](Commands& commands) { commands.inserts.clear(); });
    receive_once();
    publish_standby();
  };
  const auto start = Clock::now();
  const auto lacks_views = [&] {
    const std::size_t views = views_.count(CameraRole::Reference) + views_.count(CameraRole::Input);
    return (!before_.views || views < *before_.views) && Clock::now() - start < kViewsPatience;
  };
  while (!service_.stop.stop_requested() && (!before_.adoptable || lacks_views())) turn();
  if (!service_.take_over(turn)) return false;
  publisher_ = bus::Publisher(service_.bus);
  return true;
}

void Trainer::look_at_model(const wire::ModelPublished& published, const bus::Message& message) {
  const Options& options = *options_;
  const auto refuse = [&](std::string why) {
    before_failure_ = std::move(why);
    ++before_.refusals;
  };
  if (std::string why = model::why_not_adoptable(message, options.layout); !why.empty()) {
    return refuse(fmt::format("cannot go on with the model of {}: {}", message.header().source()->str(), why));
  }
  const std::size_t bytes = std::size_t{published.arenas()} * model::kArenaPages * model::page_bytes(options.layout);
  const bool elsewhere = published.arenas() > 0 && message.tensor("pages-0").has_value() &&
                         message.tensor("pages-0")->memory() != service_.backend;
  if (const std::size_t free = elsewhere ? bus::free_memory(service_.backend) : bytes; free < bytes) {
    return refuse(fmt::format("the model takes {} MiB of {} memory, of which {} MiB are free", bytes >> 20U,
                              name_of(service_.backend), free >> 20U));
  }
  before_.refusals = 0;
  before_.adoptable = true;
}

void Trainer::publish_standby() {
  const auto now = Clock::now();
  if (now - stats_published_ < kStandbyPeriod) return;
  stats_published_ = now;
  const auto references = static_cast<std::uint32_t>(views_.count(CameraRole::Reference));
  const auto inputs = static_cast<std::uint32_t>(views_.count(CameraRole::Input));
  service_.detail(!before_.adoptable ? "waits for the model"
                  : !before_.views   ? "waits for what the one before has"
                                     : fmt::format("has {} of {} views", references + inputs, *before_.views));
  publisher_.publish(topics::kTrainerStandby, [&](auto& builder, auto header) {
    wire::TrainerStatsBuilder stats(builder);
    stats.add_header(header);
    stats.add_ready_references(references);
    stats.add_ready_inputs(inputs);
    return stats.Finish();
  });
}

void Trainer::adopt_handover() {
  Restored restored;
  try {
    const bool adopted = bus::take_handover(
        *service_.bus, [&](std::span<const std::byte> bytes) { restored = optimizer_->restore(bytes); },
        std::numeric_limits<std::size_t>::max());
    if (adopted && restored.refusal.empty()) {
      spdlog::info("goes on with the moments and ages of {} Gaussians", restored.gaussians);
    }
    if (adopted) service_.counter("handed_over", static_cast<double>(restored.gaussians));
  } catch (const std::exception& error) {
    restored.refusal = error.what();
  }
  if (!restored.refusal.empty()) {
    spdlog::warn("moments and ages begin anew, as what was left cannot be used: {}", restored.refusal);
  }
  if (successor_) service_.ready();
}

// A trainer that is told to end may be one that is restarted: without moments and ages the next one would begin with
// the rates of a beginner, and spoil for seconds what was learned.
void Trainer::leave_behind() {
  constexpr std::size_t kMostBytes = std::size_t{512} << 20U;  // more would keep whoever ends it waiting
  if (store_->count() == 0) return;
  if (const std::size_t bytes = optimizer_->handover_bytes(); bytes > kMostBytes) {
    spdlog::info("{} MiB of moments and ages are not kept for a trainer that comes after", bytes >> 20U);
    return;
  }
  try {
    hand_over(0ms);
  } catch (const std::exception& error) {
    spdlog::warn("moments and ages are not kept for a trainer that comes after: {}", error.what());
  }
}

void Trainer::hand_over(std::chrono::milliseconds patience) {
  if (!service_.bus->wait_connected(patience)) return;
  finish_steps();
  optimizer_->publish(publisher_);
  publish_stats(false);
  const bool left = bus::leave_handover(
      *service_.bus, optimizer_->handover_bytes(), [this](std::byte* memory) { optimizer_->save(memory); }, patience);
  if (left) spdlog::info("handed over {} Gaussians at step {}", store_->count(), store_->step());
}

}  // namespace splatbus::trainer

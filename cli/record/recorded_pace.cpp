#include "recorded_pace.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>

#include "bus/clock.h"
#include "bus/error.h"
#include "recorded_message.h"
#include "wire/model_generated.h"
#include "wire/system_generated.h"

namespace splatbus::cli {

namespace {

constexpr std::uint64_t kSliceNs = 250'000'000;           // of the recording, that the trainer may be ahead
constexpr std::int64_t kStepPatienceNs = 15'000'000'000;  // for one step
constexpr std::chrono::seconds kHeartbeatPatience(10);
constexpr double kMostFillDistance = 10, kMostEma_s = 60;  // of the parameters' ranges

std::optional<double> number(const wire::Heartbeat& heartbeat, std::string_view name) {
  if (heartbeat.parameters() == nullptr) return {};
  for (const wire::KeyValue* one : *heartbeat.parameters()) {
    if (one->key()->string_view() != name) continue;
    const std::string_view text = one->value()->string_view();
    double value = 0;
    if (std::from_chars(text.data(), text.data() + text.size(), value).ec == std::errc()) return value;
  }
  return {};
}

}  // namespace

RecordedPace::RecordedPace(mcap::Reader& reader) {
  const auto& summary = reader.summary();
  const auto is_stats = [&](std::uint16_t channel) {
    const auto found = summary.channels.find(channel);
    return found != summary.channels.end() && found->second.topic == topics::kTrainerStats.name;
  };
  for (std::size_t chunk = 0; chunk < summary.chunks.size(); ++chunk) {
    const auto& offsets = summary.chunks[chunk].message_index_offsets;
    if (!offsets.empty() && std::ranges::none_of(offsets, [&](const auto& entry) { return is_stats(entry.first); })) {
      continue;
    }
    try {
      reader.read_chunk(chunk, [&](const mcap::Message& message) {
        if (!is_stats(message.channel_id)) return;
        RecordedMessage recorded(topics::kTrainerStats.name, message.data);
        const auto body = recorded.body();
        flatbuffers::Verifier verifier(body.data(), body.size());
        if (recorded.header().schema()->string_view() != kSchema<wire::TrainerStats> ||
            !verifier.VerifyBuffer<wire::TrainerStats>(nullptr)) {
          return;
        }
        const auto& stats = *flatbuffers::GetRoot<wire::TrainerStats>(body.data());
        const PaceMoment before = moments_.empty() ? PaceMoment{} : moments_.back();
        if (message.log_time < before.log_time || stats.step() < before.step) return;
        moments_.push_back({message.log_time, stats.step(), stats.steps_per_s(), stats.optimizer_s()});
      });
    } catch (const bus::Error&) {  // the player says what is wrong with a recording
    } catch (const mcap::Error&) {
    }
  }
}

std::uint64_t RecordedPace::step_at(std::uint64_t log_time) const {
  const auto after = std::ranges::upper_bound(moments_, log_time, {}, &PaceMoment::log_time);
  if (after == moments_.begin()) return 0;
  const PaceMoment& from = *std::prev(after);
  if (after == moments_.end()) return from.step;
  const double share =
      static_cast<double>(log_time - from.log_time) / static_cast<double>(after->log_time - from.log_time);
  return from.step + static_cast<std::uint64_t>(share * static_cast<double>(after->step - from.step));
}

PaceKeeper::PaceKeeper(std::shared_ptr<bus::Context> context, RecordedPace pace)
    : pace_(std::move(pace)), publisher_(context), subscriber_(std::move(context)) {
  subscriber_
      .on(topics::kTrainerStats,
          [this](const wire::TrainerStats& stats, const bus::Message&) {
            step_ = stats.step();
            optimizer_s_ = stats.optimizer_s();
          })
      .on(topics::kHeartbeat, [this](const wire::Heartbeat& heartbeat, const bus::Message&) {
        if (!ema_s_ && heartbeat.service()->string_view() == "trainer") ema_s_ = number(heartbeat, "ema_s");
        if (fill_ || heartbeat.service()->string_view() != "expander") return;
        const auto distance = number(heartbeat, "fill_distance"), steps_per_s = number(heartbeat, "fill_steps_per_s");
        if (distance && steps_per_s) fill_ = Fill{*distance, *steps_per_s};
      });
}

void PaceKeeper::set(const char* topic, const std::vector<std::pair<const char*, double>>& values) {
  publisher_.publish(topics::control(topic), [&](auto& builder, auto header) {
    std::vector<flatbuffers::Offset<wire::KeyValue>> changes;
    changes.reserve(values.size());
    for (const auto& [key, value] : values) {
      changes.push_back(wire::CreateKeyValueDirect(builder, key, fmt::format("{}", value).c_str()));
    }
    return wire::CreateControlDirect(builder, header, &changes);
  });
}

void PaceKeeper::find_expander(const std::stop_token& stop) {
  const std::int64_t end_ns = bus::now_ns() + std::chrono::nanoseconds(kHeartbeatPatience).count();
  while (!fill_ && !stop.stop_requested() && bus::now_ns() < end_ns) {
    subscriber_.dispatch_all(std::chrono::milliseconds(20));
  }
  if (!fill_) fill_ = Fill{};  // there is none
}

// As the expander does by itself with the pace of the trainer that it hears of.
void PaceKeeper::pace_expander(double steps_per_s) {
  if (fill_->distance == 0) return;
  const double scarcity =
      steps_per_s > 0 && steps_per_s < fill_->steps_per_s ? std::sqrt(fill_->steps_per_s / steps_per_s) : 1;
  set("control/expander",
      {{"fill_steps_per_s", 0}, {"fill_distance", std::min(kMostFillDistance, fill_->distance * scarcity)}});
}

void PaceKeeper::pace_average(const PaceMoment& moment) {
  if (!ema_s_ || moment.step == 0 || moment.optimizer_s <= 0 || step_ == 0 || optimizer_s_ <= 0) return;
  const double recorded = static_cast<double>(moment.step) / moment.optimizer_s;
  const double now = static_cast<double>(step_) / optimizer_s_;
  set("control/trainer", {{"ema_s", std::min(kMostEma_s, *ema_s_ * recorded / now)}});
}

void PaceKeeper::hold(std::uint64_t log_time, const std::stop_token& stop) {
  const auto& moments = pace_.moments();
  if (slice_end_ == 0) {
    find_expander(stop);
    pace_expander(0);
  }
  bool news = false;
  for (; next_moment_ < moments.size() && moments[next_moment_].log_time <= log_time; ++next_moment_) news = true;
  if (news) {
    pace_expander(moments[next_moment_ - 1].steps_per_s);
    pace_average(moments[next_moment_ - 1]);
  }
  if (log_time < slice_end_) return;
  slice_end_ = log_time + kSliceNs;
  run_until(pace_.step_at(slice_end_));
  wait_for_step(pace_.step_at(log_time), stop);
}

void PaceKeeper::finish(const std::stop_token& stop) {
  run_until(recorded_steps());
  wait_for_step(recorded_steps(), stop);
}

void PaceKeeper::run_until(std::uint64_t step) {
  // 0 would let it run for ever.
  set("control/trainer", {{"run_until", static_cast<double>(std::max<std::uint64_t>(1, step))}});
}

void PaceKeeper::wait_for_step(std::uint64_t step, const std::stop_token& stop) {
  std::uint64_t seen = step_;
  std::int64_t end_ns = bus::now_ns() + kStepPatienceNs;
  subscriber_.dispatch_all(std::chrono::milliseconds(0));
  while (step_ < step && !stop.stop_requested()) {
    if (step_ != seen) end_ns = bus::now_ns() + kStepPatienceNs;
    seen = step_;
    if (bus::now_ns() > end_ns) {
      ++given_up_;
      return;
    }
    subscriber_.dispatch_all(std::chrono::milliseconds(10));
  }
}

}  // namespace splatbus::cli

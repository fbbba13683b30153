#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <stop_token>
#include <vector>

#include "bus/publisher.h"
#include "bus/subscriber.h"
#include "mcap/reader.h"

namespace splatbus::cli {

/// What the recorded trainer/stats said at one time.
struct PaceMoment {
  std::uint64_t log_time = 0, step = 0;
  double steps_per_s = 0;
  double optimizer_s = 0;  ///< of all steps
};

/// The trainer's steps in a recording, at any time in it. None where it has no trainer/stats.
class RecordedPace {
 public:
  explicit RecordedPace(mcap::Reader& reader);
  explicit RecordedPace(std::vector<PaceMoment> moments) : moments_(std::move(moments)) {}

  [[nodiscard]] bool empty() const { return moments_.empty(); }
  [[nodiscard]] const std::vector<PaceMoment>& moments() const { return moments_; }
  /// Between two moments as if all steps took the same time.
  [[nodiscard]] std::uint64_t step_at(std::uint64_t log_time) const;

 private:
  std::vector<PaceMoment> moments_;  ///< neither time nor step ever falls
};

/// Lets a live trainer and expander have as much time for what is played as the recorded ones had: the trainer stops
/// where the recorded one was (its run_until), what is played waits for it where it is slower, and the expander, which
/// inserts by the trainer's pace, is given the recorded pace. The trainer's average over time, by its ema_s, covers as
/// many steps as it did. So the result does not depend on this machine's load. One thread.
class PaceKeeper {
 public:
  PaceKeeper(std::shared_ptr<bus::Context> context, RecordedPace pace);

  /// Called before what was recorded at that time is played; returns once the trainer is as far as it was then.
  void hold(std::uint64_t log_time, const std::stop_token& stop);
  /// Called after the last of it was played; returns once the trainer has taken the steps that were recorded later.
  void finish(const std::stop_token& stop);

  [[nodiscard]] bool known() const { return !pace_.empty(); }
  [[nodiscard]] std::uint64_t recorded_steps() const { return known() ? pace_.moments().back().step : 0; }
  /// How often the trainer took no step for so long that it was waited for no more.
  [[nodiscard]] std::uint64_t given_up() const { return given_up_; }

 private:
  void find_expander(const std::stop_token& stop);
  void pace_expander(double steps_per_s);
  void pace_average(const PaceMoment& moment);
  void run_until(std::uint64_t step);
  void wait_for_step(std::uint64_t step, const std::stop_token& stop);
  void set(const char* topic, const std::vector<std::pair<const char*, double>>& values);

  struct Fill {
    double distance = 0, steps_per_s = 0;
  };
  const RecordedPace pace_;
  bus::Publisher publisher_;
  bus::Subscriber subscriber_;
  std::optional<Fill> fill_;     ///< the expander's own parameters
  std::optional<double> ema_s_;  ///< the trainer's own
  double optimizer_s_ = 0;
  std::size_t next_moment_ = 0;
  std::uint64_t slice_end_ = 0, step_ = 0, given_up_ = 0;
};

}  // namespace splatbus::cli

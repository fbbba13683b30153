#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <exception>
#include <functional>
#include <memory>
#include <optional>

#include "expander/round.h"

namespace splatbus::expander {

/// Rounds that have come and are not in the model yet: because it is not known what the trainer has, or because there
/// was no memory for them. Those are tried again, and set aside when that has failed a few times, or when too many
/// wait. Times are CLOCK_MONOTONIC nanoseconds. Not thread-safe.
class WaitingRounds {
 public:
  static constexpr std::size_t kMost = 8;
  static constexpr int kMostTries = 5;

  /// False when the oldest had to go for it.
  bool add(IncomingRound incoming, std::int64_t now_ns);

  /// What there is to do for a round; throws when it should be tried again.
  struct Work {
    std::function<std::unique_ptr<Round>(const IncomingRound&)> take;  ///< null: what was sent is gone
    std::function<void(const Round&)> grow;                            ///< null: not yet
    /// What was thrown, for which round and whether it is tried again; may throw on.
    std::function<void(const RoundInfo&, const std::exception&, bool again)> failed;
  };

  /// Does what is due, oldest first: takes rounds, and grows by those that are taken. Returns how many were lost.
  std::size_t run(const Work& work, std::int64_t now_ns, std::int64_t retry_ns);

  [[nodiscard]] bool empty() const { return rounds_.empty(); }
  /// When the oldest came; there is one.
  [[nodiscard]] std::int64_t since_ns() const { return rounds_.front().came_ns; }

 private:
  struct Waiting {
    std::optional<IncomingRound> incoming;  // until it is taken
    std::unique_ptr<Round> round;
    std::int64_t came_ns = 0, due_ns = 0;
    int failures = 0;

    [[nodiscard]] const RoundInfo& info() const { return round ? round->info() : *incoming; }
  };
  enum class Outcome { Waits, Done, Lost };

  static Outcome advance(Waiting& waiting, const Work& work, std::int64_t now_ns, std::int64_t retry_ns);

  std::deque<Waiting> rounds_;
};

}  // namespace splatbus::expander

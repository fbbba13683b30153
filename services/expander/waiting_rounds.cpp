#include "expander/waiting_rounds.h"

#include <utility>

namespace splatbus::expander {

bool WaitingRounds::add(IncomingRound incoming, std::int64_t now_ns) {
  const bool full = rounds_.size() >= kMost;
  if (full) rounds_.pop_front();
  rounds_.push_back({.incoming = std::move(incoming), .came_ns = now_ns});
  return !full;
}

std::size_t WaitingRounds::run(const Work& work, std::int64_t now_ns, std::int64_t retry_ns) {
  std::size_t lost = 0;
  std::deque<Waiting> still;
  for (Waiting& waiting : std::exchange(rounds_, {})) {
    const Outcome outcome = advance(waiting, work, now_ns, retry_ns);
    if (outcome == Outcome::Waits) still.push_back(std::move(waiting));
    if (outcome == Outcome::Lost) ++lost;
  }
  rounds_ = std::move(still);
  return lost;
}

WaitingRounds::Outcome WaitingRounds::advance(Waiting& waiting, const Work& work, std::int64_t now_ns,
                                              std::int64_t retry_ns) {
  if (waiting.due_ns > now_ns) return Outcome::Waits;
  try {
    if (!waiting.round) {
      waiting.round = work.take(*waiting.incoming);
      if (!waiting.round) return Outcome::Lost;
      waiting.incoming.reset();
    }
    if (!work.grow) return Outcome::Waits;
    work.grow(*waiting.round);
    return Outcome::Done;
  } catch (const std::exception& error) {
    const bool again = ++waiting.failures < kMostTries;
    work.failed(waiting.info(), error, again);
    waiting.due_ns = now_ns + retry_ns;
    return again ? Outcome::Waits : Outcome::Lost;
  }
}

}  // namespace splatbus::expander

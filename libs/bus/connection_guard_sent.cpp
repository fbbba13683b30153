// Peers that do not take what they are sent.
#include <fmt/format.h>

#include <algorithm>

#include "bus/clock.h"
#include "bus/connection_guard.h"

namespace splatbus::bus {

void ConnectionGuard::look_at_sent(Connection& connection, std::uint64_t acked, bool behind, std::int64_t now,
                                   std::string& why) const {
  connection.acked = acked;
  if (!behind) {
    connection.behind_since_ns = connection.sent_since_ns = 0;
    return;
  }
  if (connection.behind_since_ns == 0) {
    connection.behind_since_ns = connection.sent_since_ns = now;
    connection.acked_when_behind = connection.acked_at_stall = acked;
  }
  if (limits_.stalled_s <= 0 || now - connection.sent_since_ns <= to_ns(limits_.stalled_s)) return;
  const auto sent = static_cast<double>(acked - connection.acked_at_stall);
  if (sent < limits_.min_sent_per_s * limits_.stalled_s && why.empty())
    why = fmt::format("it read {} bytes in {} s", sent, limits_.stalled_s);
  connection.sent_since_ns = now;
  connection.acked_at_stall = acked;
}

std::string ConnectionGuard::holds_too_much(const Connection& connection, std::int64_t now) const {
  if (connection.behind_since_ns == 0) return {};
  const double held_s = static_cast<double>(now - connection.behind_since_ns) * 1e-9;
  const auto sent = static_cast<double>(connection.acked - connection.acked_when_behind);
  if (held_s < limits_.held_s) return {};
  if (held_s < limits_.held_most_s && sent >= limits_.held_min_per_s * held_s) return {};
  return fmt::format("it read {} bytes in {:.1f} s, and others wait", sent, held_s);
}

void ConnectionGuard::make_room(const std::vector<int>& for_descriptors) {
  if (limits_.held_s <= 0) return;
  const std::int64_t now = now_ns();
  const std::scoped_lock lock(mutex_);
  const bool waits = std::ranges::any_of(for_descriptors, [&](int fd) {
    const auto found = connections_.find(fd);
    return found != connections_.end() && !found->second.closing && found->second.behind_since_ns == 0;
  });
  if (!waits) return;
  for (auto& [fd, connection] : connections_) {
    if (const std::string why = holds_too_much(connection, now); !why.empty()) shut(connection, why);
  }
}

}  // namespace splatbus::bus

#include "bus/sources.h"

#include <algorithm>
#include <cassert>
#include <iterator>
#include <utility>

#include "bus/connection_of.h"
#include "bus/own_messages.h"

namespace splatbus::bus_service {
namespace {

constexpr std::int64_t clock_slack_ns = 1'000'000'000;
constexpr std::size_t looked_at_a_call = 128;

}  // namespace

bool Sources::admit(std::string_view source, std::uint64_t epoch, zmq::message_t& frame, bool local, std::int64_t now,
                    std::string& why) {
  if (source == own_source) {
    why = "only the broker calls itself 'bus'";
    return false;
  }
  // On this machine an epoch is when a process connected, by the clock that we have too.
  if (local && epoch > static_cast<std::uint64_t>(now + clock_slack_ns)) {
    why = "its epoch lies in the future";
    return false;
  }
  const void* const connection = connection_of(frame);
  assert(connection != nullptr);
  const auto found = owners_.find(source);
  const bool known = found != owners_.end();
  if (known && found->second.connection == connection) return true;
  if (known && found->second.socket.is_open() && (found->second.local || !local)) {
    why = "another process has that name, and is there";
    return false;
  }
  if (!has_room(connection, local, known && found->second.local == local, why)) return false;
  if (known) take(found);
  Owner owner{.connection = connection, .holds = {}, .socket = bus::PeerSocket::of(frame), .local = local};
  owner.holds.copy(frame);
  give(std::string(source), std::move(owner));
  return true;
}

bool Sources::speaks_here(std::string_view source) const {
  if (source == own_source) return true;
  const auto found = owners_.find(source);
  return found != owners_.end() && found->second.local && found->second.socket.is_open();
}

bool Sources::has_room(const void* connection, bool local, bool replaces, std::string& why) const {
  const auto names = names_.find(connection);
  if (names != names_.end() && names->second >= (local ? kMaxOfAConnection : kMaxOfARemoteConnection)) {
    why = "one connection calls itself by too many names";
    return false;
  }
  if (replaces || (local ? local_ : owners_.size() - local_) < kMaxOfAKind) return true;
  why = "there are too many sources";
  return false;
}

void Sources::give(const std::string& source, Owner owner) {
  ++names_[owner.connection];
  if (owner.local) ++local_;
  owners_.emplace(source, std::move(owner));
}

Sources::Owners::iterator Sources::take(Owners::iterator entry) {
  const auto names = names_.find(entry->second.connection);
  if (--names->second == 0) names_.erase(names);
  if (entry->second.local) --local_;
  return owners_.erase(entry);
}

void Sources::forget_some() {
  auto next = owners_.upper_bound(looked_at_);
  for (std::size_t left = std::min(looked_at_a_call, owners_.size()); left > 0; --left) {
    if (next == owners_.end()) next = owners_.begin();
    looked_at_ = next->first;
    next = next->second.socket.is_open() ? std::next(next) : take(next);
  }
}

}  // namespace splatbus::bus_service

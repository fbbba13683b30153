#include "bus/sources.h"

#include <algorithm>
#include <cassert>

#include "bus/own_messages.h"

namespace splatbus::bus_service {
namespace {

constexpr std::size_t max_sources = 2048;
constexpr std::ptrdiff_t max_of_a_connection = 64;
constexpr std::int64_t clock_slack_ns = 1'000'000'000;
// libzmq's own, by which it answers ZMQ_SRCFD: every connection has one, in memory of its own.
constexpr const char* connection_property = "__fd";

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
  const void* const connection = zmq_msg_gets(frame.handle(), connection_property);
  assert(connection != nullptr);
  const auto found = owners_.find(source);
  if (found != owners_.end() && found->second.connection == connection) return true;
  if (found == owners_.end() && !make_room(connection, why)) return false;
  if (found != owners_.end() && found->second.socket.is_open() && (found->second.local || !local)) {
    why = "another process has that name, and is there";
    return false;
  }
  Owner& owner = found != owners_.end() ? found->second : owners_[std::string(source)];
  owner.connection = connection;
  owner.holds.copy(frame);
  owner.socket = bus::PeerSocket::of(frame);
  owner.local = local;
  return true;
}

bool Sources::speaks_here(std::string_view source) const {
  if (source == own_source) return true;
  const auto found = owners_.find(source);
  return found != owners_.end() && found->second.local && found->second.socket.is_open();
}

bool Sources::make_room(const void* connection, std::string& why) {
  const auto of_this =
      std::ranges::count_if(owners_, [&](const auto& entry) { return entry.second.connection == connection; });
  if (of_this >= max_of_a_connection) {
    why = "one connection calls itself by too many names";
    return false;
  }
  if (owners_.size() < max_sources) return true;
  std::erase_if(owners_, [](const auto& entry) { return !entry.second.socket.is_open(); });
  if (owners_.size() < max_sources) return true;
  why = "there are too many sources";
  return false;
}

}  // namespace splatbus::bus_service

#include "bus/sources.h"

#include <algorithm>

namespace splatbus::bus_service {
namespace {

constexpr std::size_t max_sources = 2048;
constexpr std::ptrdiff_t max_of_a_connection = 64;
constexpr std::int64_t clock_slack_ns = 1'000'000'000;
constexpr std::string_view own_source = "bus";

}  // namespace

bool Sources::admit(std::string_view source, std::uint64_t epoch, const zmq::message_t& frame, bool local,
                    std::int64_t now, std::string& why) {
  if (source == own_source) {
    why = "only the broker calls itself 'bus'";
    return false;
  }
  // On this machine an epoch is when a process connected, by the clock that we have too.
  if (local && epoch > static_cast<std::uint64_t>(now + clock_slack_ns)) {
    why = "its epoch lies in the future";
    return false;
  }
  const auto found = owners_.find(source);
  const Owner caller{socket_of(frame, local), local};
  if (found != owners_.end() && found->second.socket == caller.socket) return true;
  if (found == owners_.end()) {
    if (!make_room(caller.socket, why)) return false;
    owners_.emplace(source, caller);
    return true;
  }
  if (found->second.socket.is_open() && (found->second.local || !local)) {
    why = "another process has that name, and is there";
    return false;
  }
  found->second = caller;
  return true;
}

bus::PeerSocket Sources::socket_of(const zmq::message_t& frame, bool local) {
  if (!local) return bus::PeerSocket::of(frame);
  const int fd = bus::descriptor_of(frame);
  for (const bus::PeerSocket& known : known_) {
    if (known.fd == fd) return known;
  }
  return known_.emplace_back(bus::PeerSocket::of(frame));
}

bool Sources::speaks_here(std::string_view source) const {
  if (source == own_source) return true;
  const auto found = owners_.find(source);
  return found != owners_.end() && found->second.local && found->second.socket.is_open();
}

bool Sources::make_room(const bus::PeerSocket& socket, std::string& why) {
  const auto of_this =
      std::count_if(owners_.begin(), owners_.end(), [&](const auto& entry) { return entry.second.socket == socket; });
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

#include "bus/remote_subscriptions.h"

#include <utility>

#include "bus/connection_of.h"

namespace splatbus::bus_service {

bool RemoteSubscriptions::begin(zmq::message_t& event, const std::string& prefix) {
  const void* const connection = connection_of(event);
  if (connection == nullptr) return true;
  auto found = readers_.find(connection);
  if (found == readers_.end()) {
    if (readers_.size() >= kMaxReaders) forget_closed();
    if (readers_.size() >= kMaxReaders) return false;
    found = readers_.emplace(connection, Reader()).first;
    found->second.holds.copy(event);
    found->second.socket = bus::PeerSocket::of(event);
  }
  Reader& reader = found->second;
  if (reader.prefixes.contains(prefix)) return true;
  if (reader.prefixes.size() >= (in_all_ < kInAll ? kOfReader : kAlways)) return false;
  reader.prefixes.insert(prefix);
  ++wanted_[prefix];
  ++in_all_;
  return true;
}

void RemoteSubscriptions::end(zmq::message_t& event, const std::string& prefix) {
  // libzmq does not say whose they are that end with a connection: forget_closed() sees to those.
  const auto found = readers_.find(connection_of(event));
  if (found != readers_.end() && found->second.prefixes.erase(prefix) > 0) forget(prefix);
}

void RemoteSubscriptions::forget(const std::string& prefix) {
  const auto wanted = wanted_.find(prefix);
  if (--wanted->second == 0) wanted_.erase(wanted);
  --in_all_;
}

void RemoteSubscriptions::forget_closed() {
  std::erase_if(readers_, [&](const auto& entry) {
    if (entry.second.socket.is_open()) return false;
    for (const auto& prefix : entry.second.prefixes) forget(prefix);
    return true;
  });
}

std::vector<int> RemoteSubscriptions::readers_of(std::string_view topic) const {
  std::vector<int> result;
  for (const auto& [connection, reader] : readers_) {
    const bool is_its_own = bus::cookie_of(reader.socket.fd) == reader.socket.cookie;  // not a later connection's
    if (is_its_own && has_prefix_of(topic, reader.prefixes)) result.push_back(reader.socket.fd);
  }
  return result;
}

}  // namespace splatbus::bus_service

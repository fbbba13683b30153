#include "bus/socket_waits.h"

#include <utility>

namespace splatbus::bus_service {

std::size_t SocketWaits::add(zmq::socket_t& socket) {
  const std::size_t index = add(static_cast<int>(socket.get(zmq::sockopt::fd)));
  entries_[index].socket = &socket;
  return index;
}

std::size_t SocketWaits::add(int descriptor) {
  descriptors_.push_back({descriptor, POLLIN, 0});
  entries_.emplace_back();
  return entries_.size() - 1;
}

void SocketWaits::wait(int timeout_ms) {
  for (Entry& entry : entries_) {
    const bool look = std::exchange(entry.used, false) && entry.socket != nullptr;
    entry.readable = look && (entry.socket->get(zmq::sockopt::events) & ZMQ_POLLIN) != 0;
    if (entry.readable) timeout_ms = 0;
  }
  if (::poll(descriptors_.data(), descriptors_.size(), timeout_ms) <= 0) return;
  for (std::size_t i = 0; i < entries_.size(); ++i) {
    entries_[i].readable = entries_[i].readable || (descriptors_[i].revents & POLLIN) != 0;
  }
}

}  // namespace splatbus::bus_service

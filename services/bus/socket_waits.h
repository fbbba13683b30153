#pragma once

#include <poll.h>

#include <cstddef>
#include <vector>
#include <zmq.hpp>

namespace splatbus::bus_service {

/// Waits until one of several ZeroMQ sockets and descriptors can be read, by one system call where zmq_poll() takes two
/// a socket and one. ZMQ_FD is edge-triggered: what was heard while something else was done with a socket is not said
/// again. So say used() of each that was sent to, bound or asked for an option, or not read until there was nothing
/// left. One thread, the sockets'.
class SocketWaits {
 public:
  /// Either returns its index. A socket outlives this.
  std::size_t add(zmq::socket_t& socket);
  std::size_t add(int descriptor);

  /// Its descriptor may have been emptied although there is something to be read.
  void used(std::size_t index) { entries_[index].used = true; }

  void wait(int timeout_ms);
  /// Of the last wait().
  [[nodiscard]] bool readable(std::size_t index) const { return entries_[index].readable; }

 private:
  struct Entry {
    zmq::socket_t* socket = nullptr;
    bool used = true, readable = false;
  };
  std::vector<Entry> entries_;
  std::vector<pollfd> descriptors_;
};

}  // namespace splatbus::bus_service

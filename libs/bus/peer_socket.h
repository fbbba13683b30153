#pragma once

#include <cstdint>
#include <zmq.hpp>

namespace splatbus::bus {

/// The descriptor of the connection that a message came by, -1 when libzmq does not say. Its number is soon another's.
[[nodiscard]] int descriptor_of(const zmq::message_t& frame);

/// The kernel's name for a socket, unique while the machine runs; 0 for what is none (any more).
[[nodiscard]] std::uint64_t cookie_of(int fd);

/// A connection of a ZeroMQ socket in this process, told apart from later ones that get its descriptor's number.
struct PeerSocket {
  int fd = -1;
  std::uint64_t cookie = 0;

  [[nodiscard]] static PeerSocket of(const zmq::message_t& frame);
  /// False once the peer has closed it, though libzmq may not have seen that yet.
  [[nodiscard]] bool is_open() const;
  friend bool operator==(const PeerSocket&, const PeerSocket&) = default;
};

}  // namespace splatbus::bus

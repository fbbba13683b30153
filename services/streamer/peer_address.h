#pragma once

#include <string>
#include <string_view>
#include <zmq.hpp>

namespace splatbus::streamer {

/// Where a peer is.
struct PeerAddress {
  bool is_local = false;  ///< over ipc, which only this user's processes can be
  std::string text;       ///< that counts as one for bounds; empty over ipc

  static constexpr const char* kLoopback = "127.0.0.1";  ///< what all of this machine's are over tcp
};

/// By what libzmq says of the connection that a message came by.
[[nodiscard]] PeerAddress peer_address(const zmq::message_t& message);

/// By the text that libzmq has for it: "1.2.3.4", "fe80::1", or over ipc "host:uid:gid:pid". An IPv6 network of 64 bits
/// counts as one, and so does this machine over tcp: there are as many addresses as somebody likes.
[[nodiscard]] PeerAddress parse_peer_address(std::string_view text);

}  // namespace splatbus::streamer

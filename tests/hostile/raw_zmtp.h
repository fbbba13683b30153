#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>

#include "bus/file_descriptor.h"

namespace splatbus::hostile {

/// A ZMTP 3.1 peer that keeps to no rule but those that it is asked to: libzmq's own cannot misbehave. Blocking, with
/// timeouts.
class RawZmtp {
 public:
  /// Connects. `endpoint` is tcp://127.0.0.1:port or ipc:///path. Throws std::runtime_error.
  explicit RawZmtp(const std::string& endpoint);
  /// None if nobody is let in within two seconds.
  static std::optional<RawZmtp> try_connect(const std::string& endpoint);

  /// The greeting with a mechanism of 20 characters at most, and the server's. False when the peer closed.
  bool greet(const std::string& mechanism = "NULL");
  /// greet() and READY as a socket of that type (DEALER, XPUB, SUB), to the server's READY.
  bool handshake(const std::string& socket_type);

  /// A frame of a message. False when the peer has closed the connection, or takes nothing for `patience`.
  bool send_frame(const std::string& bytes, bool more);
  bool send_command(const std::string& name, const std::string& data);
  /// Just the head of a frame that claims to have `bytes`.
  bool send_frame_head(std::uint64_t bytes, bool more);
  bool send_bytes(const std::string& bytes);

  /// Closes, and has the peer told by a reset.
  void reset();
  /// Reads and forgets until the peer has closed or `timeout` is over; whether it closed.
  bool closed_within(std::chrono::milliseconds timeout);
  /// Reads up to `bytes`, and waits for the first of them; empty when the peer closed or nothing came.
  std::string read_some(std::size_t bytes, std::chrono::milliseconds timeout);

  [[nodiscard]] int fd() const { return socket_.get(); }

 private:
  bool read_exactly(std::size_t bytes, std::string& into);

  bus::FileDescriptor socket_;
};

/// More messages than may wait, and pings behind them, in one piece.
void send_messages_and_pings(RawZmtp& raw, const std::string& message);

}  // namespace splatbus::hostile

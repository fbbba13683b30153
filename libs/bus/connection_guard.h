#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <mutex>
#include <string>
#include <string_view>
#include <thread>
#include <vector>
#include <zmq.hpp>

#include "bus/door.h"
#include "bus/file_descriptor.h"
#include "bus/held_connection.h"
#include "bus/log_sink.h"
#include "bus/token_bucket.h"

namespace splatbus::bus {

/// What one tcp connection to a socket, and all of them, may take. What is 0 is not bounded.
struct ConnectionLimits {
  std::size_t connections = 1024;          ///< fewer where the process may not have that many descriptors
  std::size_t of_one_address = 256;        ///< connections
  std::size_t unread_bytes = 0;            ///< received, and not taken yet
  std::size_t first_unread_bytes = 0;      ///< the same before its first message
  std::size_t all_unread_bytes = 0;        ///< of all connections; the largest goes
  std::size_t all_left_bytes = 0;          ///< of those that are gone; nobody new comes in while it is more
  std::size_t all_first_unread_bytes = 0;  ///< of all that had no message taken
  double bytes_per_s = 0;                  ///< received, with `burst_bytes` at once
  double burst_bytes = 0;
  double greeting_s = 0;        ///< to its first message
  double silence_s = 0;         ///< from one message to the next
  double stalled_s = 0;         ///< with bytes to send, and less than `min_sent_per_s` of them sent
  double min_sent_per_s = 1e4;  ///< bytes
  /// Where others wait (make_room()): with bytes to send all the time for `held_s`, fewer than `held_min_per_s` of them
  /// sent a second; or for `held_most_s`.
  double held_s = 0, held_min_per_s = 0, held_most_s = 0;
};

/// Bounds what tcp peers can take through a bound ZeroMQ socket, where libzmq has no setting for it: it counts whole
/// messages only, so that one without an end grows for ever, and accepts whoever comes. The kernel counts each
/// connection's bytes; a thread compares them with what the owner took, and shuts down the connection that is out of
/// bounds, whereupon libzmq gives back what it held of it. Connections over ipc are not looked at.
class ConnectionGuard {
 public:
  /// Before the socket binds to tcp; in the socket's context. `name` is for the log.
  ConnectionGuard(zmq::context_t& context, zmq::socket_t& socket, const ConnectionLimits& limits, std::string name);
  ~ConnectionGuard();  ///< before the socket closes
  ConnectionGuard(const ConnectionGuard&) = delete;
  ConnectionGuard& operator=(const ConnectionGuard&) = delete;

  /// A whole message of so many bytes was taken from the socket; `frame` is any of its frames.
  void took(const zmq::message_t& frame, std::size_t bytes);

  /// Nothing was left to take. Until then what has come counts as unread, whosever messages are taken. Say it whenever
  /// the queue is found empty, even if nothing came: what those have left who are gone is forgotten by it.
  void drained() { drained_ = true; }

  /// Shuts down the connection that a message came by.
  void close(const zmq::message_t& frame, const std::string& why);

  /// There is no room to send something to these connections. Where one of them has taken all that it was sent, those
  /// connections that hold too much for too long are shut down.
  void make_room(const std::vector<int>& for_descriptors);

  /// From the guard's thread, about every second, with the key of each connection that has sent something: false shuts
  /// it down.
  void keep_only(std::function<bool(const std::string& key)> allowed);

  struct Counts {
    std::size_t open = 0;
    std::uint64_t accepted = 0, closed = 0;  ///< `closed`: by the guard
  };
  [[nodiscard]] Counts counts() const;

 private:
  struct Connection {
    HeldConnection held;
    std::uint64_t cookie = 0;  ///< the kernel's name for the connection: a descriptor's number is soon another's
    std::string address, key;
    std::int64_t since_ns = 0, heard_ns = 0, sent_since_ns = 0, behind_since_ns = 0;
    bool taken = false, taken_lately = false;
    std::uint64_t received = 0, read = 0, acked = 0, acked_at_stall = 0, acked_when_behind = 0;
    TokenBucket bytes{0, 1};
    bool closing = false;

    [[nodiscard]] std::uint64_t unread() const { return received - std::min(read, received); }
  };
  static std::int64_t to_ns(double seconds) { return static_cast<std::int64_t>(seconds * 1e9); }
  void run(const std::stop_token& stop);
  void accept_events();
  void begin(int fd);
  void tend_door();
  /// Looks at all of them. Returns the bytes that came, and were not taken, by the one of which there are the most.
  std::uint64_t sweep(std::int64_t now);
  bool look(Connection& connection, bool drained, std::int64_t now, std::string& why);
  void look_at_sent(Connection& connection, std::uint64_t acked, bool behind, std::int64_t now, std::string& why) const;
  [[nodiscard]] std::string holds_too_much(const Connection& connection, std::int64_t now) const;
  void shut(Connection& connection, const std::string& why);
  /// What it has brought, and nobody has read, is still there when it is gone.
  void count_left(Connection& connection);

  const ConnectionLimits limits_;
  const std::string name_;
  mutable std::mutex mutex_;
  std::map<int, Connection> connections_;
  std::function<bool(const std::string&)> allowed_;
  std::atomic<bool> drained_ = false;
  std::int64_t next_key_check_ns_ = 0;
  std::uint64_t left_ = 0, left_lately_ = 0;  ///< bytes not taken of those that are gone; `lately`: since a drained()
  Door door_;
  Counts counts_;
  LogLimiter limiter_;
  zmq::socket_t& guarded_;
  zmq::socket_t events_;
  FileDescriptor wake_;
  std::jthread thread_;
};

/// Raises this process's limit on descriptors as far as it may: slabs take two each, connections over tcp too.
void raise_descriptor_limit();

}  // namespace splatbus::bus

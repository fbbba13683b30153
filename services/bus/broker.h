#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "bus/address.h"
#include "bus/curve.h"

namespace splatbus::bus_service {

struct BrokerOptions {
  bus::Address address;                 ///< local: the folder of the sockets, made with mode 0700 when it is missing
  std::optional<std::string> tcp_host;  ///< interface to listen on ("127.0.0.1", "*") for readers and writers elsewhere
  std::uint16_t tcp_port = 0;           ///< XSUB there, XPUB at the next; 0: two free ones in a row
  std::size_t max_held_messages = 8192;                 ///< latched messages kept, of all topics
  std::size_t max_held_bytes = std::size_t{256} << 20;  ///< of them; one source holds half of both at most
  bus::ServerKeyFiles keys;                             ///< for tcp that others than this machine reach
  /// What peers over tcp may take in all: the largest message, unfinished ones, and what is not sent to readers yet. As
  /// much may wait for readers of this machine, to whom others' bulk data goes with the message.
  std::size_t max_remote_bytes = std::size_t{256} << 20;
  std::chrono::milliseconds slab_grace{10000};  ///< how long slabs of a source that has gone wait for it
};

/// Counters since start().
struct BrokerStatistics {
  std::uint64_t relayed = 0;    ///< messages
  std::uint64_t malformed = 0;  ///< did not verify, and went no further
  std::uint64_t inlined = 0;    ///< sent to tcp readers with the slabs' bytes
  /// Not sent to tcp readers, since the slab was gone or its slot overwritten; or to those of one side, for want of
  /// room.
  std::uint64_t inline_dropped = 0;
  std::uint64_t unheld = 0;  ///< latched, and too large to be held
  std::uint64_t held = 0;    ///< latched messages now
  std::uint64_t slabs = 0;   ///< registered now
};

/// The bus process: relays messages from its XSUB to its XPUB, keeps the last value of latched topics, registers slabs,
/// tells who is alive. Runs on threads of its own, in splatbus-bus or within a test.
class Broker {
 public:
  explicit Broker(BrokerOptions options);
  ~Broker();  ///< stops
  Broker(const Broker&) = delete;
  Broker& operator=(const Broker&) = delete;

  /// Throws bus::Error: the address is not local, the folder is another user's, another broker runs there, a port is
  /// taken. When it returns, clients can connect.
  void start();
  void stop();

  /// False once somebody has removed the folder: nobody who comes finds this broker any more.
  [[nodiscard]] bool intact() const;
  [[nodiscard]] const bus::Address& address() const;
  [[nodiscard]] std::optional<bus::Address> tcp_address() const;  ///< after start(), with the ports really taken
  [[nodiscard]] BrokerStatistics statistics() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace splatbus::bus_service

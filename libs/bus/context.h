#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "bus/slab.h"

namespace splatbus::bus {

/// CLOCK_MONOTONIC, nanoseconds.
[[nodiscard]] std::int64_t now_ns();

/// Where a bus is. `ipc:///some/dir`: a folder that holds the broker's sockets (xsub, xpub, slabs) and its lock file.
/// `tcp://host:port`: the broker's XSUB is at port, its XPUB at port + 1, and there are no slabs: tensors ride inline.
struct Address {
  /// Throws Error that names the text and what is wrong with it.
  static Address parse(const std::string& text);
  /// SPLATBUS_BUS when set, else ipc:///run/user/<uid>/splatbus or ipc:///tmp/splatbus-<uid>.
  static Address from_environment();

  [[nodiscard]] bool is_local() const { return directory.has_value(); }
  [[nodiscard]] std::string publish_endpoint() const;    ///< publishers connect here (the broker's XSUB)
  [[nodiscard]] std::string subscribe_endpoint() const;  ///< subscribers connect here (the broker's XPUB)
  [[nodiscard]] std::string slab_socket() const;         ///< path; local only
  [[nodiscard]] std::string text() const;

  std::optional<std::string> directory;
  std::string host;
  std::uint16_t port = 0;
};

/// A process's connection to a bus: the ZeroMQ context, its name, its epoch and its slab client. Thread-safe. Publisher
/// and Subscriber keep the context alive.
class Context : public std::enable_shared_from_this<Context> {
 public:
  /// `source` is unique on the bus ("trainer", "viewer-2"). Connecting never blocks: the broker may start later.
  static std::shared_ptr<Context> create(Address address, std::string source);
  ~Context();

  [[nodiscard]] const Address& address() const;
  [[nodiscard]] const std::string& source() const;
  [[nodiscard]] std::uint64_t epoch() const;
  [[nodiscard]] void* zmq_context() const;  ///< for sockets of a service's own, e.g. the streamer's endpoint

  /// Makes a host slab and registers it under "<source>/<role>"; a slab registered under that name before is dropped
  /// by the registry (mappings that others hold stay good). Waits up to `timeout_ms` for the broker. Over tcp the slab
  /// is private memory and its tensors are inlined. Throws Error.
  std::shared_ptr<Slab> create_slab(const std::string& role, std::size_t slots, std::size_t slot_bytes,
                                    int timeout_ms = 10000);

  /// Opens a registered slab by id or by full name, read-only or for adoption; cached by id. Null when the registry has no such
  /// slab or cannot be reached; throws Error when what it got is malformed (a slab smaller than it claims).
  std::shared_ptr<Slab> open_slab(std::uint64_t id);
  std::shared_ptr<Slab> adopt_slab(const std::string& name);  ///< mapped writable: a restarted owner goes on with it

 private:
  struct Impl;
  explicit Context(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
  friend class Publisher;
  friend class Subscriber;
};

}  // namespace splatbus::bus

#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <string>

#include "bus/address.h"
#include "bus/clock.h"
#include "bus/slab.h"

namespace splatbus::bus {

/// A process's connection to a bus: the ZeroMQ context, its name, its epoch and its slab client. Thread-safe. Publisher
/// and Subscriber keep the context alive.
class Context : public std::enable_shared_from_this<Context> {
 public:
  /// `source` is unique on the bus ("trainer", "viewer-2"). Connecting never blocks: the broker may start later, or be
  /// killed and started again; the context then registers its slabs and sends its latched messages again by itself.
  /// Throws Error when `source` is no name (1 to 64 characters, no spaces or control characters), when the folder is
  /// not this user's alone, and when it takes a key to get there and there is none.
  static std::shared_ptr<Context> create(Address address, std::string source);
  ~Context();

  [[nodiscard]] const Address& address() const;
  [[nodiscard]] const std::string& source() const;
  [[nodiscard]] std::uint64_t epoch() const;
  /// For sockets of a service's own, e.g. the streamer's endpoint. Close them before the context goes.
  [[nodiscard]] void* zmq_context() const;

  /// Waits until the broker takes messages; false after `timeout`. Nobody has to call this: what is published before
  /// waits in a bounded queue (docs/protocol.md, "Start-up").
  [[nodiscard]] bool wait_connected(std::chrono::milliseconds timeout) const;

  /// What becomes of a slab when the process that made it is gone, and no other of its name comes within seconds.
  enum class SlabLife : std::uint8_t {
    OfItsMaker,   ///< the registry drops it
    ForSuccessor  ///< it stays for adopt_slab()
  };

  /// Makes a slab and registers it under "<source>/<role>"; a slab registered under that name before is dropped
  /// by the registry (mappings that others hold stay good). Waits up to `timeout_ms` for the broker. Over tcp the slab
  /// is private memory and its tensors are inlined. Throws Error, also for a kind that this build has no memory for,
  /// and when another process is there that writes slabs as this source.
  std::shared_ptr<Slab> create_slab(const std::string& role, std::size_t slots, std::size_t slot_bytes,
                                    int timeout_ms = 10000, Device kind = Device::Cpu,
                                    SlabLife life = SlabLife::OfItsMaker);

  /// The two halves of create_slab(), for a thread that may not wait. This one makes a slab that nobody can open yet.
  std::shared_ptr<Slab> make_slab(const std::string& role, std::size_t slots, std::size_t slot_bytes, Device kind,
                                  SlabLife life = SlabLife::OfItsMaker);
  /// Registers what make_slab() made; false when the broker does not answer within `timeout`. Throws Error when it
  /// refuses the slab.
  [[nodiscard]] bool register_slab(const std::shared_ptr<Slab>& slab, std::chrono::milliseconds timeout);

  /// Opens a registered slab, read-only; cached by id. Null when the registry has no such slab or cannot be reached;
  /// throws Error when what it got is malformed (a slab smaller than it claims).
  std::shared_ptr<Slab> open_slab(std::uint64_t id);

  /// The same by full name ("trainer/model"), mapped writable: a restarted owner goes on with what it left.
  /// Waits up to `timeout_ms` for the broker, so that null means that there is none of that name. Throws Error when
  /// another process is there that writes it.
  std::shared_ptr<Slab> adopt_slab(const std::string& name, int timeout_ms = 10000);

  /// Lets go of the connection to the broker that this source publishes by, so that another process may have its name.
  /// What is published later goes nowhere; subscribers, and slabs that they open, stay as they are.
  void fall_silent();

  /// Takes the lease of this source's slabs, and with it the name: who lets go of its connection to the broker lets go
  /// of the lease last. Waits up to `timeout` for another process that has it. Throws Error naming that process when it
  /// stays. Does nothing over tcp, and where no broker answers.
  void claim(std::chrono::milliseconds timeout);

  /// Takes the lease of a part that only one process of a bus may play ("model": whoever writes the model), whatever
  /// its source is called, for as long as this context lives. Otherwise as claim().
  void claim_part(const std::string& part, std::chrono::milliseconds timeout);

  /// Makes the registry forget a slab of this source; mappings that others hold stay good.
  void drop_slab(const std::string& role);

 private:
  struct Impl;
  explicit Context(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
  friend class Publisher;
  friend class Subscriber;
};

}  // namespace splatbus::bus

#pragma once

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <thread>

#include "bus/file_descriptor.h"
#include "bus/slab.h"
#include "bus/slab_protocol.h"

namespace splatbus::bus {

/// A process's connection to the slab registry. A thread keeps it up: when the broker goes, it connects again with a
/// growing pause, or at once when it hears of a new one, and registers this process's slabs anew under the same ids.
/// Thread-safe.
class SlabClient {
 public:
  explicit SlabClient(std::string socket_path);  ///< tries to connect once, and goes on trying
  ~SlabClient();
  SlabClient(const SlabClient&) = delete;
  SlabClient& operator=(const SlabClient&) = delete;

  /// Registers, and again after each reconnection for as long as the slab lives. False when the registry cannot be
  /// reached within `timeout`; throws Error when it refuses the slab.
  [[nodiscard]] bool add(const std::shared_ptr<Slab>& slab, std::chrono::milliseconds timeout);

  /// Registers again after a reconnection what is registered already (an adopted slab).
  void keep(const std::shared_ptr<Slab>& slab);

  void drop(const std::string& name);

  /// Takes a source's lease, and again after each reconnection. Asks for up to `timeout` while another process has it;
  /// throws Error then. Returns without it when the registry cannot be reached.
  void claim(const std::string& source, std::chrono::milliseconds timeout);

  /// A broker is there (again): ends the pause before the next try.
  void look();

  /// Whether the registry that is there has all slabs of this process, of which there may be none. Never waits: where
  /// it cannot be known at once, false.
  [[nodiscard]] bool has_registered_all();

  /// The registry's answer to Open, or to OpenByName where `name` is not empty; nullopt when it has no such slab or
  /// cannot be reached within `timeout`, or by one try where that is longer. Throws Error when another process writes
  /// the slabs of that name's source.
  std::optional<SlabPacket> open(std::uint64_t id, const std::string& name, std::chrono::milliseconds timeout);

 private:
  void run(const std::stop_token& stop);
  void take_wake() const;
  bool connect();
  bool connected();
  [[nodiscard]] bool is_live() const;
  std::optional<SlabPacket> ask(SlabOperation operation, const SlabDescriptor& descriptor, int control_fd, int data_fd);
  std::optional<SlabPacket> ask_for_lease(const std::string& source);
  void register_all();

  const std::string socket_path_;
  std::mutex mutex_;
  std::condition_variable connected_changed_;
  FileDescriptor socket_;  // closed by the thread alone; others shut it down
  bool connected_ = false;
  std::map<std::string, std::weak_ptr<Slab>> own_;
  std::set<std::string> claimed_;  // sources
  std::atomic<std::uint64_t> looks_wanted_ = 0;
  std::uint64_t looks_done_ = 0;  // those of them that a try began after
  FileDescriptor wake_;
  std::jthread thread_;
};

}  // namespace splatbus::bus

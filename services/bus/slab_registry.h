#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "bus/file_descriptor.h"
#include "bus/log_sink.h"
#include "bus/slab.h"
#include "bus/slab_protocol.h"

namespace splatbus::bus_service {

/// Keeps duplicates of every registered slab's descriptors and hands them out, over a Unix socket, to this user's
/// processes. A slab goes when its name is registered again or released; and some seconds after its source has gone,
/// unless it is kept for a successor.
///
/// Who registers or opens by name holds the lease of that name's source for as long as it is connected, and nobody else
/// writes its slabs meanwhile.
class SlabRegistry {
 public:
  /// Listens at `socket_path`; `grace`: how long the slabs of a source that has gone wait for it. Throws bus::Error.
  explicit SlabRegistry(const std::string& socket_path, std::chrono::milliseconds grace = std::chrono::seconds(10));
  ~SlabRegistry();
  SlabRegistry(const SlabRegistry&) = delete;
  SlabRegistry& operator=(const SlabRegistry&) = delete;

  /// The slab mapped read-only, or null. Any thread.
  [[nodiscard]] std::shared_ptr<bus::Slab> find(std::uint64_t id);
  [[nodiscard]] std::size_t size() const;

 private:
  void run(const std::stop_token& stop);
  struct Client {
    bus::FileDescriptor socket;
    std::uint64_t number = 0;
    pid_t pid = 0;
  };
  void accept_client();
  bool serve(const Client& client);
  bus::SlabPacket answer(bus::SlabPacket& request, const Client& client, std::shared_ptr<bus::Slab>& opened);
  void add(bus::SlabPacket& request);
  void remove(const std::string& name);
  /// Throws bus::Error when another process holds the lease of the name's source, and is there.
  void take_lease(const std::string& name, const Client& client);
  void end_leases(const Client& client);
  void collect();

  mutable std::mutex mutex_;
  std::map<std::uint64_t, std::shared_ptr<bus::Slab>> by_id_;
  std::map<std::string, std::uint64_t> by_name_;
  const std::string socket_path_;
  bus::FileDescriptor listener_;
  bus::FileDescriptor wake_;
  const std::chrono::milliseconds grace_;
  std::vector<Client> clients_;
  std::uint64_t next_client_ = 1;
  std::map<std::string, std::uint64_t, std::less<>> leases_;       ///< source to Client::number
  std::map<std::string, std::int64_t, std::less<>> abandoned_ns_;  ///< sources that have gone, and when
  bus::LogLimiter limiter_;
  std::jthread thread_;
};

}  // namespace splatbus::bus_service

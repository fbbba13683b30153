#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "bus/file_descriptor.h"
#include "bus/slab.h"
#include "bus/slab_protocol.h"

namespace splatbus::bus_service {

/// Keeps duplicates of every registered slab's descriptors and hands them out, over a Unix socket. A slab outlives the
/// process that made it; it goes when its name is registered again or released.
class SlabRegistry {
 public:
  /// Listens at `socket_path`. Throws bus::Error.
  explicit SlabRegistry(const std::string& socket_path);
  ~SlabRegistry();
  SlabRegistry(const SlabRegistry&) = delete;
  SlabRegistry& operator=(const SlabRegistry&) = delete;

  /// The slab mapped read-only, or null. Any thread.
  [[nodiscard]] std::shared_ptr<bus::Slab> find(std::uint64_t id);
  [[nodiscard]] std::size_t size() const;

 private:
  void run(const std::stop_token& stop);
  void accept_client();
  bool serve(int client);
  bus::SlabPacket answer(bus::SlabPacket& request, std::shared_ptr<bus::Slab>& opened);
  void add(bus::SlabPacket& request);
  void remove(const std::string& name);

  mutable std::mutex mutex_;
  std::map<std::uint64_t, std::shared_ptr<bus::Slab>> by_id_;
  std::map<std::string, std::uint64_t> by_name_;
  const std::string socket_path_;
  bus::FileDescriptor listener_;
  bus::FileDescriptor wake_;
  std::vector<bus::FileDescriptor> clients_;
  std::jthread thread_;
};

}  // namespace splatbus::bus_service

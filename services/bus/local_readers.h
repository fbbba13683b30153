#pragma once

#include <cstdint>
#include <map>
#include <set>
#include <string>
#include <zmq.hpp>

#include "bus/liveness.h"
#include "bus/peer_socket.h"

namespace splatbus::bus_service {

/// Which processes of this machine asked for which topics: the kernel names the process at the other end of a Unix
/// socket, and its heartbeat names the source. Nobody has to say it. One thread.
class LocalReaders {
 public:
  /// A subscription, or its end, that came as `event`.
  void note(const zmq::message_t& event, const std::string& prefix, bool begins);
  void forget_closed();

  /// Sources that read the topic, 16 at most; a process without heartbeats is "pid N".
  [[nodiscard]] std::set<std::string> names(const std::string& topic,
                                            const std::map<std::string, Liveness::Node>& nodes) const;

 private:
  struct Reader {
    bus::PeerSocket socket;
    std::uint32_t pid = 0;
    std::set<std::string> prefixes;
  };
  std::map<std::uint64_t, Reader> readers_;  ///< by the socket's cookie
};

}  // namespace splatbus::bus_service

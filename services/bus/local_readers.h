#pragma once

#include <cstdint>
#include <map>
#include <set>
#include <string>
#include <vector>
#include <zmq.hpp>

#include "bus/liveness.h"
#include "bus/peer_socket.h"

namespace splatbus::bus_service {

/// Which processes of this machine asked for which topics: the kernel names the process at the other end of a Unix
/// socket, and its heartbeat names the source. Nobody has to say it. And which of them take nothing. One thread.
class LocalReaders {
 public:
  /// A subscription, or its end, that came as `event`.
  void note(const zmq::message_t& event, const std::string& prefix, bool begins);
  void forget_closed();

  /// Looks which of them the kernel has bytes for that they do not take. To be called a few times a second.
  void look(std::int64_t now);
  /// Closes those of which bytes wait and that have taken none for seconds, as far as looks tell: what waits for them
  /// keeps others from large messages. A process that was only stopped connects again. Returns their processes.
  std::vector<std::uint32_t> close_stuck(std::int64_t now);

  /// Sources that read the topic, 16 at most; a process without heartbeats is "pid N".
  [[nodiscard]] std::set<std::string> names(const std::string& topic,
                                            const std::map<std::string, Liveness::Node>& nodes) const;

 private:
  struct Reader {
    bus::PeerSocket socket;
    std::uint32_t pid = 0;
    std::set<std::string> prefixes;
    int untaken = 0;                   ///< bytes, at the last look
    std::int64_t behind_since_ns = 0;  ///< since when it has taken nothing; 0: it has taken all
  };
  std::map<std::uint64_t, Reader> readers_;  ///< by the socket's cookie
};

}  // namespace splatbus::bus_service

#pragma once

#include <cstddef>
#include <map>
#include <set>
#include <string>
#include <string_view>
#include <vector>
#include <zmq.hpp>

#include "bus/peer_socket.h"

namespace splatbus::bus_service {

/// Whether one of some texts begins the topic. Topics are short, and the texts may be many.
template <class Prefixes>
[[nodiscard]] bool has_prefix_of(std::string_view topic, const Prefixes& prefixes) {
  for (std::size_t length = 0; !prefixes.empty() && length <= topic.size(); ++length) {
    if (prefixes.contains(topic.substr(0, length))) return true;
  }
  return false;
}

/// What each reader over tcp asked for. Bounds are a reader's own, so that nobody takes what another needs. One thread.
class RemoteSubscriptions {
 public:
  static constexpr std::size_t kOfReader = 1024, kInAll = 65536;
  static constexpr std::size_t kAlways = 64;        ///< of a reader, however many others have
  static constexpr std::size_t kMaxReaders = 1024;  ///< as connections

  /// A subscription that came as `event`. False when it is not taken: the reader, or all of them, have too many.
  [[nodiscard]] bool begin(zmq::message_t& event, const std::string& prefix);
  void end(zmq::message_t& event, const std::string& prefix);
  void forget_closed();

  [[nodiscard]] bool wants(std::string_view topic) const { return has_prefix_of(topic, wanted_); }
  /// Descriptors of the connections of those who want it.
  [[nodiscard]] std::vector<int> readers_of(std::string_view topic) const;

 private:
  struct Reader {
    zmq::message_t holds;  ///< by which no later connection gets that address
    bus::PeerSocket socket;
    std::set<std::string, std::less<>> prefixes;
  };
  void forget(const std::string& prefix);

  std::map<const void*, Reader> readers_;  ///< by the connection as libzmq knows it: descriptors are soon another's
  std::map<std::string, std::size_t, std::less<>> wanted_;  ///< by how many readers
  std::size_t in_all_ = 0;
};

}  // namespace splatbus::bus_service

#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "bus/peer_socket.h"

namespace splatbus::bus_service {

/// Which connection speaks as which source: the first one that does, for as long as it is there. One of this machine
/// takes a name from one over tcp, never the other way round.
class Sources {
 public:
  /// Whether a message that came by `frame`'s connection may call itself that; `why` says why not.
  bool admit(std::string_view source, std::uint64_t epoch, const zmq::message_t& frame, bool local, std::int64_t now,
             std::string& why);

  /// Connections of this machine are looked up once a turn: one that closes and another that gets its descriptor's
  /// number within it count as one.
  void begin_turn() { known_.clear(); }

  /// Whether that source is of this machine and its connection is there.
  [[nodiscard]] bool speaks_here(std::string_view source) const;

 private:
  struct Owner {
    bus::PeerSocket socket;
    bool local = false;
  };
  [[nodiscard]] bus::PeerSocket socket_of(const zmq::message_t& frame, bool local);
  bool make_room(const bus::PeerSocket& socket, std::string& why);

  std::map<std::string, Owner, std::less<>> owners_;
  std::vector<bus::PeerSocket> known_;  // of this turn
};

}  // namespace splatbus::bus_service

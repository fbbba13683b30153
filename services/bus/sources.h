#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <zmq.hpp>

#include "bus/peer_socket.h"

namespace splatbus::bus_service {

/// Which connection speaks as which source: the first one that does, for as long as it is there. One of this machine
/// takes a name from one over tcp, never the other way round.
class Sources {
 public:
  /// Whether a message that came by `frame`'s connection may call itself that; `why` says why not.
  bool admit(std::string_view source, std::uint64_t epoch, zmq::message_t& frame, bool local, std::int64_t now,
             std::string& why);

  /// Whether that source is of this machine and its connection is there.
  [[nodiscard]] bool speaks_here(std::string_view source) const;

 private:
  /// A connection as libzmq knows it, unlike its descriptor's number also once that is closed and another's: what the
  /// connection sent last may be read later than that.
  struct Owner {
    const void* connection = nullptr;
    zmq::message_t holds;  // by which no other connection gets that address
    bus::PeerSocket socket;
    bool local = false;
  };
  bool make_room(const void* connection, std::string& why);

  std::map<std::string, Owner, std::less<>> owners_;
};

}  // namespace splatbus::bus_service

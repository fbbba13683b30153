#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <zmq.hpp>

#include "bus/peer_socket.h"

namespace splatbus::bus_service {

/// Which connection speaks as which source: the first one that does, for as long as it is there. One of this machine
/// takes a name from one over tcp, never the other way round, and both kinds have places of their own.
class Sources {
 public:
  static constexpr std::size_t kMaxOfAKind = 1024;
  static constexpr std::size_t kMaxOfAConnection = 64, kMaxOfARemoteConnection = 8;  ///< names

  /// Whether a message that came by `frame`'s connection may call itself that; `why` says why not.
  bool admit(std::string_view source, std::uint64_t epoch, zmq::message_t& frame, bool local, std::int64_t now,
             std::string& why);

  /// Frees the places of those that are closed among some, the next ones at each call: to look at one takes system
  /// calls.
  void forget_some();

  /// Whether that source is of this machine and its connection is there.
  [[nodiscard]] bool speaks_here(std::string_view source) const;

 private:
  struct Owner {
    const void* connection = nullptr;
    zmq::message_t holds;  // by which no other connection gets that address
    bus::PeerSocket socket;
    bool local = false;
  };
  using Owners = std::map<std::string, Owner, std::less<>>;
  /// `replaces`: it takes the place of one of its kind.
  bool has_room(const void* connection, bool local, bool replaces, std::string& why) const;
  void give(const std::string& source, Owner owner);
  Owners::iterator take(Owners::iterator entry);

  Owners owners_;
  std::map<const void*, std::size_t> names_;  ///< of a connection
  std::size_t local_ = 0;                     ///< of owners_
  std::string looked_at_;                     ///< last, of owners_
};

}  // namespace splatbus::bus_service

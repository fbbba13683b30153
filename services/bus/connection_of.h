#pragma once

#include <zmq.hpp>

namespace splatbus::bus_service {

/// The connection that a message came by as libzmq knows it, unlike its descriptor's number also once that is closed
/// and another's: what the connection sent last may be read later than that. Nobody else's for as long as a copy of the
/// message is kept; null where libzmq does not say.
[[nodiscard]] inline const void* connection_of(zmq::message_t& frame) {
  // libzmq's own, by which it answers ZMQ_SRCFD: every connection has one, in memory of its own.
  return zmq_msg_gets(frame.handle(), "__fd");
}

}  // namespace splatbus::bus_service

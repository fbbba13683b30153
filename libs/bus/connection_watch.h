#pragma once

#include <zmq.hpp>

namespace splatbus::bus {

/// Before bind() or connect(): a peer over tcp that does not answer, or takes nothing of what waits for it, for five
/// seconds is taken for gone, by tcp's own means. ZMTP's heartbeats are of no use: libzmq ends the process when one is
/// due, or late, while a full queue keeps a connection from being read (its issue 3937, and an assertion of
/// out_event()).
void watch_connections(zmq::socket_t& socket);

}  // namespace splatbus::bus

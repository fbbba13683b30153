#pragma once

#include <zmq.hpp>

namespace splatbus::bus {

/// What every socket of the bus is set to: high-water marks, the farewell's linger, the size limit of a frame,
/// reconnection, and heartbeats on connections that leave the machine.
void configure_socket(zmq::socket_t& socket, bool local);

}  // namespace splatbus::bus

#include "bus/sockets.h"

#include "bus/frames.h"

namespace splatbus::bus {
namespace {

// Bulk data rides in slabs on this machine, so that many small messages may wait; over tcp they carry it.
constexpr int local_high_water_mark = 4096;
constexpr int remote_high_water_mark = 256;
constexpr int linger_ms = 500;
constexpr int reconnect_ms = 50;
constexpr int reconnect_max_ms = 500;
constexpr int heartbeat_ms = 1000;
constexpr int heartbeat_timeout_ms = 5000;

}  // namespace

void configure_socket(zmq::socket_t& socket, bool local) {
  const int high_water_mark = local ? local_high_water_mark : remote_high_water_mark;
  socket.set(zmq::sockopt::sndhwm, high_water_mark);
  socket.set(zmq::sockopt::rcvhwm, high_water_mark);
  socket.set(zmq::sockopt::linger, linger_ms);
  socket.set(zmq::sockopt::maxmsgsize, max_frame_bytes);
  socket.set(zmq::sockopt::reconnect_ivl, reconnect_ms);
  socket.set(zmq::sockopt::reconnect_ivl_max, reconnect_max_ms);
  if (local) return;
  socket.set(zmq::sockopt::heartbeat_ivl, heartbeat_ms);
  socket.set(zmq::sockopt::heartbeat_timeout, heartbeat_timeout_ms);
}

}  // namespace splatbus::bus

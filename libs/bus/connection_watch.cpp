#include "bus/connection_watch.h"

namespace splatbus::bus {

namespace {

constexpr int kEvery_s = 1, kAsks = 4, kGone_ms = 5000;

}  // namespace

void watch_connections(zmq::socket_t& socket) {
  socket.set(zmq::sockopt::tcp_keepalive, 1);
  socket.set(zmq::sockopt::tcp_keepalive_idle, kEvery_s);
  socket.set(zmq::sockopt::tcp_keepalive_intvl, kEvery_s);
  socket.set(zmq::sockopt::tcp_keepalive_cnt, kAsks);
  socket.set(zmq::sockopt::tcp_maxrt, kGone_ms);  // of what was sent and is not acknowledged: TCP_USER_TIMEOUT
}

}  // namespace splatbus::bus

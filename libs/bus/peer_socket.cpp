#include "bus/peer_socket.h"

#include <poll.h>
#include <sys/socket.h>

namespace splatbus::bus {

int descriptor_of(const zmq::message_t& frame) {
  return zmq_msg_get(frame.handle(), ZMQ_SRCFD);
}

std::uint64_t cookie_of(int fd) {
  std::uint64_t cookie = 0;
  socklen_t size = sizeof(cookie);
  return ::getsockopt(fd, SOL_SOCKET, SO_COOKIE, &cookie, &size) == 0 ? cookie : 0;
}

PeerSocket PeerSocket::of(const zmq::message_t& frame) {
  const int fd = descriptor_of(frame);
  return {fd, cookie_of(fd)};
}

bool PeerSocket::is_open() const {
  if (cookie == 0 || cookie_of(fd) != cookie) return false;
  pollfd item{fd, POLLRDHUP, 0};
  return ::poll(&item, 1, 0) == 0;
}

}  // namespace splatbus::bus

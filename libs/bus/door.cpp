#include "bus/door.h"

#include <linux/filter.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include <utility>

#include "bus/peer_socket.h"

namespace splatbus::bus {

void Door::add(int listener) {
  int protocol = 0;
  socklen_t size = sizeof(protocol);
  if (::getsockopt(listener, SOL_SOCKET, SO_PROTOCOL, &protocol, &size) != 0 || protocol != IPPROTO_TCP) return;
  std::erase_if(listeners_, [](const Listener& old) { return cookie_of(old.fd) != old.cookie; });
  listeners_.push_back({listener, cookie_of(listener)});
  if (!open_) apply(listeners_.back());
}

void Door::set_open(bool open) {
  if (std::exchange(open_, open) == open) return;
  for (const Listener& listener : listeners_) apply(listener);
}

void Door::apply(const Listener& listener) const {
  if (cookie_of(listener.fd) != listener.cookie) return;
  if (open_) {
    const int none = 0;
    ::setsockopt(listener.fd, SOL_SOCKET, SO_DETACH_FILTER, &none, sizeof(none));
    return;
  }
  sock_filter drop = BPF_STMT(BPF_RET | BPF_K, 0);
  const sock_fprog program{1, &drop};
  ::setsockopt(listener.fd, SOL_SOCKET, SO_ATTACH_FILTER, &program, sizeof(program));
}

}  // namespace splatbus::bus

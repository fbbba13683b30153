#include "bus/door.h"

#include <linux/filter.h>
#include <sys/socket.h>

#include <utility>

namespace splatbus::bus {

void Door::add(int listener) {
  listeners_.push_back(listener);
  if (!open_) apply(listener);
}

void Door::set_open(bool open) {
  if (std::exchange(open_, open) == open) return;
  for (const int listener : listeners_) apply(listener);
}

void Door::apply(int listener) const {
  int listens = 0;
  socklen_t size = sizeof(listens);
  if (::getsockopt(listener, SOL_SOCKET, SO_ACCEPTCONN, &listens, &size) != 0 || listens == 0) return;
  if (open_) {
    const int none = 0;
    ::setsockopt(listener, SOL_SOCKET, SO_DETACH_FILTER, &none, sizeof(none));
    return;
  }
  sock_filter drop = BPF_STMT(BPF_RET | BPF_K, 0);
  const sock_fprog program{1, &drop};
  ::setsockopt(listener, SOL_SOCKET, SO_ATTACH_FILTER, &program, sizeof(program));
}

}  // namespace splatbus::bus

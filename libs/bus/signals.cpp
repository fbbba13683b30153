#include "bus/signals.h"

#include <pthread.h>
#include <signal.h>
#include <unistd.h>

namespace splatbus::bus {

StopSignals::StopSignals(std::stop_source& source) {
  sigset_t signals;
  ::sigemptyset(&signals);
  ::sigaddset(&signals, SIGINT);
  ::sigaddset(&signals, SIGTERM);
  ::pthread_sigmask(SIG_BLOCK, &signals, nullptr);
  thread_ = std::jthread([signals, &source](const std::stop_token& end) {
    const timespec wait{0, 100'000'000};  // how soon `end` is seen; a signal is seen at once
    while (!end.stop_requested()) {
      if (::sigtimedwait(&signals, nullptr, &wait) < 0) continue;
      if (source.stop_requested()) ::_exit(130);
      source.request_stop();
    }
  });
}

}  // namespace splatbus::bus

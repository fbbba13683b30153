#include "viewer/round_trip.h"

#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/socket.h>

namespace splatbus::viewer {

std::optional<double> tcp_round_trip_ms(int descriptor) {
  tcp_info info{};
  socklen_t bytes = sizeof(info);
  if (::getsockopt(descriptor, IPPROTO_TCP, TCP_INFO, &info, &bytes) != 0 || info.tcpi_rtt == 0) return std::nullopt;
  return info.tcpi_rtt / 1000.0;
}

}  // namespace splatbus::viewer

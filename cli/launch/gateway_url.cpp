#include "gateway_url.h"

#include <arpa/inet.h>
#include <fmt/format.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include <filesystem>

#include "bus/file_descriptor.h"

namespace splatbus::cli {

namespace {

/// The port that a socket on loopback is given when it asks for this one (0: any); 0 when it is taken.
std::uint16_t free_port(std::uint16_t port) {
  const bus::FileDescriptor probe(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
  const int on = 1;
  ::setsockopt(probe.get(), SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(port);
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t bytes = sizeof address;
  auto* generic = reinterpret_cast<sockaddr*>(&address);
  // A bind alone succeeds beside a socket that listens when both reuse addresses on some systems: listen as well.
  if (::bind(probe.get(), generic, bytes) != 0 || ::listen(probe.get(), 1) != 0) return 0;
  ::getsockname(probe.get(), generic, &bytes);
  return ntohs(address.sin_port);
}

}  // namespace

std::optional<GatewayUrl> settle_gateway(LaunchFile& file, std::uint16_t port) {
  for (LaunchService& service : file.services) {
    if (std::filesystem::path(service.program.value).filename() != "splatbus-gateway") continue;
    GatewayUrl result;
    if (!service.parameters.contains("http")) {
      std::uint16_t found = free_port(port);
      result.elsewhere = found == 0;
      if (found == 0) found = free_port(0);
      service.parameters["http"] = {fmt::format("127.0.0.1:{}", found), service.mark};
    }
    std::string address = service.parameters.at("http").value;
    for (const char* any : {"127.0.0.1:", "0.0.0.0:", "[::1]:", "[::]:"}) {
      if (address.starts_with(any)) address = "localhost" + address.substr(address.rfind(':'));
    }
    result.url = fmt::format("{}://{}", service.parameters.contains("certificate") ? "https" : "http", address);
    return result;
  }
  return std::nullopt;
}

std::string invitation(const GatewayUrl& gateway) {
  return fmt::format("open {} in a browser{}", gateway.url,
                     gateway.elsewhere ? fmt::format(" (port {} is taken)", kGatewayPort) : "");
}

}  // namespace splatbus::cli

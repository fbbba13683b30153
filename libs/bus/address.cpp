#include "bus/address.h"

#include <fmt/format.h>
#include <unistd.h>

#include <charconv>
#include <cstdlib>
#include <filesystem>
#include <string_view>

#include "bus/error.h"
#include "bus/schemes.h"

namespace splatbus::bus {
namespace {

// A Unix socket's path has room for 107 characters; "/slabs" is the longest that we append.
constexpr std::size_t max_directory_length = 100;

[[noreturn]] void refuse(const std::string& text, std::string_view why) {
  throw Error(fmt::format("bus address '{}': {}", text, why));
}

Address parse_tcp(const std::string& text) {
  const auto rest = std::string_view(text).substr(tcp_scheme.size());
  const auto colon = rest.rfind(':');
  if (colon == std::string_view::npos || colon == 0) refuse(text, "expected tcp://host:port");
  const auto port_text = rest.substr(colon + 1);
  unsigned port = 0;
  const auto [end, error] = std::from_chars(port_text.data(), port_text.data() + port_text.size(), port);
  if (error != std::errc() || end != port_text.data() + port_text.size() || port == 0 || port > 65534) {
    refuse(text, "the port must be a number from 1 to 65534 (the port after it is used too)");
  }
  Address address;
  address.host = rest.substr(0, colon);
  address.port = static_cast<std::uint16_t>(port);
  return address;
}

}  // namespace

Address Address::parse(const std::string& text) {
  if (text.starts_with(tcp_scheme)) return parse_tcp(text);
  if (!text.starts_with(ipc_scheme)) refuse(text, "expected ipc:///directory or tcp://host:port");
  auto directory = text.substr(ipc_scheme.size());
  while (directory.size() > 1 && directory.back() == '/') directory.pop_back();
  if (directory.empty() || directory.front() != '/') refuse(text, "the directory must be an absolute path");
  if (directory.find('\0') != std::string::npos) refuse(text, "the directory holds a zero byte");
  if (directory.size() > max_directory_length) {
    refuse(text, fmt::format("the directory is longer than the {} characters that a Unix socket leaves room for",
                             max_directory_length));
  }
  Address address;
  address.directory = std::move(directory);
  return address;
}

Address Address::from_environment() {
  const char* variable = std::getenv("SPLATBUS_BUS");
  if (variable != nullptr && *variable != '\0') return parse(variable);
  const auto runtime_directory = fmt::format("/run/user/{}", ::geteuid());
  std::error_code ignored;
  if (std::filesystem::is_directory(runtime_directory, ignored) && ::access(runtime_directory.c_str(), W_OK) == 0) {
    return parse(fmt::format("ipc://{}/splatbus", runtime_directory));
  }
  return parse(fmt::format("ipc:///tmp/splatbus-{}", ::geteuid()));
}

std::string Address::publish_endpoint() const {
  return is_local() ? fmt::format("ipc://{}/xsub", *directory) : fmt::format("tcp://{}:{}", host, port);
}

std::string Address::subscribe_endpoint() const {
  return is_local() ? fmt::format("ipc://{}/xpub", *directory) : fmt::format("tcp://{}:{}", host, port + 1);
}

std::string Address::slab_socket() const {
  return directory.value() + "/slabs";
}

std::string Address::text() const {
  return is_local() ? fmt::format("ipc://{}", *directory) : fmt::format("tcp://{}:{}", host, port);
}

}  // namespace splatbus::bus

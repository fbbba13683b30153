#pragma once

#include <string>
#include <string_view>

namespace splatbus::viewer {

/// Where a gateway's stream is.
struct WebAddress {
  bool tls = false;
  std::string host, port, target, token;

  /// For its Host field.
  [[nodiscard]] std::string authority() const;
};

/// Whether it begins as one: ws://, wss://, http:// or https://.
[[nodiscard]] bool is_web_address(std::string_view url);

/// "wss://host:7680", or the page's own address, "https://host:7680/#token=T", as people send it to each other. Without
/// a port it is 80, or 443 with TLS; the path is always /stream. Throws bus::Error naming it.
[[nodiscard]] WebAddress parse_web_address(std::string_view url);

}  // namespace splatbus::viewer

#include "bus/text_rules.h"

#include <charconv>
#include <string_view>

namespace splatbus::bus {
namespace {

bool is_port(std::string_view text) {
  if (text == "*") return true;
  unsigned port = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), port);
  return error == std::errc() && end == text.data() + text.size() && port <= 65535;
}

bool is_endpoint(std::string_view text) {
  if (text.empty()) return true;
  constexpr std::string_view ipc = "ipc://";
  constexpr std::string_view tcp = "tcp://";
  if (text.starts_with(ipc)) return text.size() > ipc.size();
  if (!text.starts_with(tcp)) return false;
  text.remove_prefix(tcp.size());
  const auto colon = text.rfind(':');
  return colon != std::string_view::npos && colon > 0 && text.find('/') == std::string_view::npos &&
         is_port(text.substr(colon + 1));
}

bool is_web_address(std::string_view text) {
  for (const std::string_view scheme : {"ws://", "wss://"}) {
    if (text.starts_with(scheme)) return text.size() > scheme.size();
  }
  return false;
}

}  // namespace

TextRule endpoint_rule() {
  return {"an endpoint such as tcp://HOST:PORT or ipc://PATH",
          [](const std::string& text) { return is_endpoint(text); }};
}

TextRule viewer_endpoint_rule() {
  return {"an endpoint such as tcp://HOST:PORT, ipc://PATH or wss://HOST:PORT",
          [](const std::string& text) { return is_endpoint(text) || is_web_address(text); }};
}

}  // namespace splatbus::bus

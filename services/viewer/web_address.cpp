#include "viewer/web_address.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cstdint>

#include "bus/error.h"

namespace splatbus::viewer {

namespace {

struct Scheme {
  std::string_view prefix;
  bool tls;
};
constexpr std::array<Scheme, 4> kSchemes{{{"ws://", false}, {"wss://", true}, {"http://", false}, {"https://", true}}};

const Scheme* scheme_of(std::string_view url) {
  const auto found = std::find_if(kSchemes.begin(), kSchemes.end(),
                                  [&](const Scheme& scheme) { return url.starts_with(scheme.prefix); });
  return found == kSchemes.end() ? nullptr : found;
}

/// Of "a=1&token=T", behind '?' or '#'.
std::string token_in(std::string_view list) {
  constexpr std::string_view kName = "token=";
  while (!list.empty()) {
    const std::string_view part = list.substr(0, list.find('&'));
    if (part.starts_with(kName)) return std::string(part.substr(kName.size()));
    list.remove_prefix(std::min(part.size() + 1, list.size()));
  }
  return {};
}

bool is_port(std::string_view text) {
  std::uint16_t port = 0;
  const auto parsed = std::from_chars(text.data(), text.data() + text.size(), port);
  return parsed.ec == std::errc() && parsed.ptr == text.data() + text.size() && port != 0;
}

}  // namespace

bool is_web_address(std::string_view url) {
  return scheme_of(url) != nullptr;
}

std::string WebAddress::authority() const {
  return fmt::format("{}:{}", host.find(':') == std::string::npos ? host : fmt::format("[{}]", host), port);
}

WebAddress parse_web_address(std::string_view url) {
  const auto wrong = [&] {
    // Without what may be a secret.
    return bus::Error(fmt::format("{}: no address such as wss://host:7680", url.substr(0, url.find_first_of("?#"))));
  };
  const Scheme* scheme = scheme_of(url);
  if (scheme == nullptr) throw wrong();
  std::string_view rest = url.substr(scheme->prefix.size());
  const std::size_t end = std::min(rest.find_first_of("/?#"), rest.size());
  std::string_view authority = rest.substr(0, end);
  rest.remove_prefix(end);
  WebAddress address{.tls = scheme->tls, .host = {}, .port = {}, .target = "/stream", .token = {}};
  if (const std::size_t marker = rest.find_first_of("?#"); marker != std::string_view::npos) {
    const std::size_t hash = std::min(rest.find('#'), rest.size());
    address.token = token_in(rest.substr(std::min(hash + 1, rest.size())));
    if (address.token.empty()) address.token = token_in(rest.substr(marker + 1, hash - std::min(hash, marker + 1)));
  }
  const bool bracketed = authority.starts_with('[');
  const std::size_t close = bracketed ? authority.find(']') : 0;
  if (close == std::string_view::npos) throw wrong();
  const std::size_t colon = authority.find(':', close);
  address.host = bracketed ? authority.substr(1, close - 1) : authority.substr(0, colon);
  if (bracketed && close + 1 != std::min(colon, authority.size())) throw wrong();
  address.port = colon != std::string_view::npos ? std::string(authority.substr(colon + 1))
                 : address.tls                   ? "443"
                                                 : "80";
  const bool strange = address.host.find_first_of("@ \t\r\n\\") != std::string::npos;
  if (address.host.empty() || strange || !is_port(address.port)) throw wrong();
  return address;
}

}  // namespace splatbus::viewer

#include "streamer/peer_address.h"

#include <arpa/inet.h>

#include <algorithm>
#include <array>

namespace splatbus::streamer {

namespace {

constexpr std::size_t kNetworkBytes = 8, kMappedBytes = 12;
constexpr std::string_view kLoopback = "127.";

bool is_number(std::string_view text) {
  return !text.empty() && std::ranges::all_of(text, [](char c) { return c >= '0' && c <= '9'; });
}

// No address of IP is written so: one of version 6 has seven colons, or two in a row.
bool has_process(std::string_view text) {
  for (int part = 0; part < 3; ++part) {
    const std::size_t colon = text.rfind(':');
    if (colon == std::string_view::npos || !is_number(text.substr(colon + 1))) return false;
    text = text.substr(0, colon);
  }
  return text.find(':') == std::string_view::npos;
}

// This machine has sixteen million addresses of its own.
PeerAddress of_v4(const std::string& text) {
  return {.is_local = false, .text = text.starts_with(kLoopback) ? PeerAddress::kLoopback : text};
}

}  // namespace

PeerAddress parse_peer_address(std::string_view text) {
  if (has_process(text)) return {.is_local = true, .text = {}};
  const std::string plain(text.substr(0, text.find('%')));  // without an interface's name
  in6_addr v6{};
  if (::inet_pton(AF_INET6, plain.c_str(), &v6) != 1) return of_v4(plain);
  const std::array<char, kMappedBytes> mapped{0, 0, 0, 0, 0, 0, 0, 0, 0, 0, '\xff', '\xff'};
  const auto* bytes = reinterpret_cast<const char*>(&v6);
  if (std::equal(mapped.begin(), mapped.end(), bytes)) {
    std::array<char, INET_ADDRSTRLEN> v4{};
    ::inet_ntop(AF_INET, bytes + kMappedBytes, v4.data(), v4.size());
    return of_v4(v4.data());
  }
  if (IN6_IS_ADDR_LOOPBACK(&v6)) return of_v4(PeerAddress::kLoopback);
  return {.is_local = false, .text = std::string(bytes, kNetworkBytes)};
}

PeerAddress peer_address(const zmq::message_t& message) {
  const char* text = zmq_msg_gets(message.handle(), "Peer-Address");
  return text == nullptr ? PeerAddress{.is_local = false, .text = "unknown"} : parse_peer_address(text);
}

}  // namespace splatbus::streamer

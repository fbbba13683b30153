#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string_view>

namespace splatbus::gateway {

/// Why somebody was turned away, or sent home.
enum class Refusal : std::uint8_t { Busy, Host, Origin, Token, Malformed, Forbidden, Flood, Stalled };
inline constexpr std::array<std::string_view, 8> kRefusalNames{"busy",      "host",      "origin", "token",
                                                               "malformed", "forbidden", "flood",  "stalled"};

/// Of Foxglove's clients.
struct FoxgloveFigures {
  std::size_t clients = 0, queued_bytes = 0;
  std::uint64_t dropped = 0;  ///< messages that slow ones were not sent
};

/// The gateway's own figures. One thread.
struct Traffic {
  std::size_t connections = 0, viewers = 0;
  std::size_t queued_bytes = 0;                      ///< of packets that are being written
  std::uint64_t bytes_from = 0, bytes_to = 0;        ///< of WebSocket messages, browsers' side
  std::uint64_t messages_from = 0, messages_to = 0;  ///< the same
  std::uint64_t requests = 0;
  std::uint64_t moves = 0;     ///< of browsers, from one streamer to another
  std::size_t page_bytes = 0;  ///< of pages that are kept to be served again
  std::uint64_t pages_served = 0, pages_fetched = 0, exports = 0;
  FoxgloveFigures foxglove;
  std::array<std::uint64_t, kRefusalNames.size()> refused{};

  void refuse(Refusal why) { ++refused[static_cast<std::size_t>(why)]; }
  [[nodiscard]] std::uint64_t refusals(Refusal why) const { return refused[static_cast<std::size_t>(why)]; }
};

}  // namespace splatbus::gateway

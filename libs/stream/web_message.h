#pragma once

#include <fmt/format.h>

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

#include "stream/bytes.h"

namespace splatbus::stream {

/// The WebSocket's subprotocol of which these are messages.
inline constexpr const char* kWebSubprotocol = "splatbus.stream.1";

/// One message, taken apart: u32 (lowest byte first) length of the Packet, the Packet, and its payload to the end of
/// the message. Views into the message.
struct WebMessage {
  std::span<const std::uint8_t> packet, payload;
};

/// Bytes in front of a Packet.
inline constexpr std::size_t kWebHeaderBytes = 4;

[[nodiscard]] inline std::array<std::uint8_t, kWebHeaderBytes> web_header(std::size_t packet_bytes) {
  std::array<std::uint8_t, kWebHeaderBytes> header{};
  for (std::size_t i = 0; i < header.size(); ++i) header[i] = static_cast<std::uint8_t>(packet_bytes >> (8 * i));
  return header;
}

/// Throws StreamError when the length is 0 or points past the message.
[[nodiscard]] inline WebMessage take_apart(std::span<const std::uint8_t> message) {
  std::size_t packet_bytes = 0;
  for (std::size_t i = 0; i < kWebHeaderBytes && i < message.size(); ++i) {
    packet_bytes |= std::size_t{message[i]} << (8 * i);
  }
  if (message.size() <= kWebHeaderBytes || packet_bytes == 0 || packet_bytes > message.size() - kWebHeaderBytes) {
    throw StreamError(fmt::format("a message of {} bytes that names a Packet of {}", message.size(), packet_bytes));
  }
  const auto rest = message.subspan(kWebHeaderBytes);
  return {.packet = rest.first(packet_bytes), .payload = rest.subspan(packet_bytes)};
}

}  // namespace splatbus::stream

#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include "bus/rights.h"
#include "wire/stream_generated.h"

namespace splatbus::gateway {

/// One WebSocket message of subprotocol splatbus.stream.1, taken apart: u32 (lowest byte first) length of the Packet,
/// the Packet, and its payload to the end of the message. Views into the message.
struct FramedPacket {
  std::span<const std::uint8_t> packet, payload;
};

/// Bytes in front of a Packet.
inline constexpr std::size_t kFrameHeaderBytes = 4;

/// Throws stream::StreamError when the length is 0 or points past the message.
[[nodiscard]] FramedPacket unframe(std::span<const std::uint8_t> message);

enum class Passage : std::uint8_t { Pass, Forbidden };

/// Whether what a browser sent may go on to the streamer under these rights; who may not steer says where it looks
/// nevertheless, since it is sent first what it sees best, and the streamer knows its rights too. Throws
/// stream::StreamError when it is no Packet; the message may lie at any address.
[[nodiscard]] Passage examine(const FramedPacket& message, const bus::Rights& rights);

}  // namespace splatbus::gateway

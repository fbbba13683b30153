#pragma once

#include <cstdint>

#include "bus/rights.h"
#include "stream/web_message.h"
#include "wire/stream_generated.h"

namespace splatbus::gateway {

using FramedPacket = stream::WebMessage;

enum class Passage : std::uint8_t { Pass, Forbidden };

/// Whether what a browser sent may go on to the streamer under these rights; who may not steer says where it looks
/// nevertheless, since it is sent first what it sees best, and the streamer knows its rights too. Throws
/// stream::StreamError when it is no Packet; the message may lie at any address.
[[nodiscard]] Passage examine(const FramedPacket& message, const bus::Rights& rights);

}  // namespace splatbus::gateway

#pragma once

#include <cstdint>
#include <functional>
#include <string>

#include "stream/packets.h"
#include "wire/convert.h"

namespace splatbus::hostile {

/// What viewers say to a streamer, as packets.
inline std::string packet(wire::Body body,
                          const std::function<flatbuffers::Offset<void>(flatbuffers::FlatBufferBuilder&)>& build) {
  const auto encoded =
      stream::PacketWriter("hostile", 1).write(1, 0, body, [&](auto& builder) { return build(builder); });
  return {encoded.packet.begin(), encoded.packet.end()};
}
inline std::string hello() {
  return packet(wire::Body::Hello, [](auto& b) { return wire::CreateHelloDirect(b, "x").Union(); });
}
inline std::string bye() {
  return packet(wire::Body::Bye, [](auto& b) { return wire::CreateByeDirect(b, "x").Union(); });
}
inline std::string pose(const Camera& of) {
  return packet(wire::Body::Pose, [&](auto& b) {
    const wire::Camera camera = to_wire(of);
    return wire::CreatePose(b, &camera).Union();
  });
}
inline std::string probe(std::uint64_t id, const Camera& of) {
  return packet(wire::Body::Probe, [&](auto& b) {
    const wire::Camera camera = to_wire(of);
    return wire::CreateProbe(b, id, &camera).Union();
  });
}

}  // namespace splatbus::hostile

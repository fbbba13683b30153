#pragma once

#include <cstdint>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <vector>

#include "gaussians/camera.h"
#include "stream/stream_model.h"
#include "wire/share_generated.h"

namespace splatbus::streamer {

/// What of a page is wanted, or given.
struct ShareWant {
  std::uint32_t page = 0;
  wire::SharePart part{};
  auto operator<=>(const ShareWant&) const = default;
};

/// What was wanted: all Pages of a page's version in the order of its lanes, or how it sees each light.
struct ShareAnswer {
  ShareWant what;
  std::uint32_t version = 0, structure = 0;  ///< of a page
  std::vector<stream::EncodedPacket> packets;
};

/// A wire::StreamShare. Packets are the very bytes that viewers are sent.
struct ShareMessage {
  /// Which stream the sender offers, and where its versions are.
  struct Place {
    std::uint64_t epoch = 0;  ///< of the stream; 0: none
    ParameterLayout layout;
    float mean_step = 0;  ///< m
    std::uint32_t version = 0;
    bool encodes = false;
  };
  /// What its tick began with.
  struct Viewers {
    bool followed = false;
    double bytes_per_s = 0;
    std::set<std::uint32_t> held;
    std::vector<Camera> cameras;
  };
  Place place;
  std::optional<Viewers> viewers;
  std::optional<std::vector<stream::OfferedPage>> pages;  ///< all that it encodes, by number
  std::vector<stream::DeltaPacket> deltas;
  std::vector<stream::VisibilityPacket> visibility;
  std::vector<ShareAnswer> answers;
  std::vector<ShareWant> wants;
};

/// Versions that one replica may have used without being heard, and how many such blocks a stream has.
inline constexpr std::uint32_t kVersionBlock = 1U << 18U, kVersionBlocks = 0xFFFFFFFFU / kVersionBlock;
inline constexpr std::size_t kMaxShareWants = 256;                              ///< in one message
inline constexpr std::size_t kMaxSharePages = 2 * stream::kMaxGaussians / 256;  ///< as many as a viewer has blocks for

/// From a peer, which may say anything: throws StreamError when a packet does not verify, is none that replicas share,
/// or names itself otherwise than its place does, and std::runtime_error when a number makes no sense. What packets
/// contain is checked by who applies them: viewers.
[[nodiscard]] ShareMessage read_share(const wire::StreamShare& body);

[[nodiscard]] flatbuffers::Offset<wire::StreamShare> write_share(flatbuffers::FlatBufferBuilder& builder,
                                                                 flatbuffers::Offset<wire::Header> header,
                                                                 const ShareMessage& message);

/// Of its packets.
[[nodiscard]] std::size_t answer_bytes(const ShareAnswer& answer);

}  // namespace splatbus::streamer

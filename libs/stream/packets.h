#pragma once

#include <flatbuffers/flatbuffers.h>

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <utility>

#include "stream/bytes.h"
#include "wire/stream_generated.h"

namespace splatbus::stream {

/// One message as it travels: the Packet's FlatBuffer, and the payload frame (empty: none is sent).
struct EncodedPacket {
  wire::Body body{};
  std::uint64_t sequence = 0;  ///< 0: not numbered (yet)
  Bytes packet, payload;

  [[nodiscard]] std::size_t bytes() const { return packet.size() + payload.size(); }
};

/// Numbers a packet that PacketWriter has written: what several viewers are sent is encoded once.
void set_sequence(EncodedPacket& packet, std::uint64_t sequence);
/// Where the number is in such a packet, 8 bytes, lowest first.
[[nodiscard]] std::size_t sequence_offset(std::span<const std::uint8_t> packet);

/// Writes Packets of one source.
class PacketWriter {
 public:
  /// `source_epoch`: CLOCK_MONOTONIC ns at which the source started.
  PacketWriter(std::string source, std::uint64_t source_epoch) : source_(std::move(source)), epoch_(source_epoch) {}

  /// One without source, epoch and publish_ns in its headers, for what is sent often: stream_epoch says whose it is.
  [[nodiscard]] static PacketWriter brief() { return {"", 0}; }
  [[nodiscard]] std::uint64_t source_epoch() const { return epoch_; }

  /// `build` receives the builder and returns the body's offset, whose type is `body`. `capture_ns`: CLOCK_MONOTONIC of
  /// the engine's frame, 0 when there is none.
  template <class Build>
  [[nodiscard]] EncodedPacket write(std::uint64_t stream_epoch, std::uint64_t sequence, wire::Body body, Build&& build,
                                    Bytes payload = {}, std::int64_t capture_ns = 0) const {
    flatbuffers::FlatBufferBuilder builder(256);
    const flatbuffers::Offset<void> content = build(builder).Union();
    return finish(builder, stream_epoch, sequence, body, content, std::move(payload), capture_ns);
  }

 private:
  EncodedPacket finish(flatbuffers::FlatBufferBuilder& builder, std::uint64_t stream_epoch, std::uint64_t sequence,
                       wire::Body body, flatbuffers::Offset<void> content, Bytes payload,
                       std::int64_t capture_ns) const;
  std::string source_;
  std::uint64_t epoch_;
};

/// A verified packet; shares its memory when copied.
class ParsedPacket {
 public:
  /// Copies both (they may be unaligned in a message's memory). Throws StreamError when a size is above its limit, the
  /// buffer does not verify, or its schema is not Packet/4.
  static ParsedPacket parse(std::span<const std::uint8_t> packet, std::span<const std::uint8_t> payload);

  [[nodiscard]] const wire::Packet& root() const { return *root_; }
  [[nodiscard]] wire::Body body() const { return root_->body_type(); }
  [[nodiscard]] std::uint64_t sequence() const { return root_->header()->sequence(); }
  [[nodiscard]] std::int64_t capture_ns() const { return root_->header()->capture_ns(); }
  [[nodiscard]] std::uint64_t stream_epoch() const { return root_->stream_epoch(); }
  [[nodiscard]] std::span<const std::uint8_t> payload() const { return content_->payload; }
  [[nodiscard]] std::size_t bytes() const { return content_->packet.size() * 8 + content_->payload.size(); }

 private:
  struct Content {
    std::vector<std::uint64_t> packet;  // aligned as FlatBuffers needs it
    Bytes payload;
  };
  std::shared_ptr<const Content> content_;
  const wire::Packet* root_ = nullptr;
};

}  // namespace splatbus::stream

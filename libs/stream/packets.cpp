#include "stream/packets.h"

#include <fmt/format.h>

#include <chrono>
#include <cstring>

#include "stream/bytes.h"
#include "stream/layout.h"

namespace splatbus::stream {

namespace {

constexpr const char* kSchema = "Packet/4";

std::int64_t now_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

}  // namespace

EncodedPacket PacketWriter::finish(flatbuffers::FlatBufferBuilder& builder, std::uint64_t stream_epoch,
                                   std::uint64_t sequence, wire::Body body, flatbuffers::Offset<void> content,
                                   Bytes payload, std::int64_t capture_ns) const {
  const auto schema = builder.CreateString(kSchema);
  const auto source = builder.CreateString(source_);
  wire::HeaderBuilder header(builder);
  header.add_schema(schema);
  header.add_source(source);
  builder.ForceDefaults(true);  // it is written when the packet is sent
  header.add_sequence(sequence);
  builder.ForceDefaults(false);
  header.add_epoch(epoch_);
  header.add_capture_ns(capture_ns);
  if (epoch_ != 0) header.add_publish_ns(now_ns());
  const auto header_offset = header.Finish();
  builder.Finish(wire::CreatePacket(builder, header_offset, stream_epoch, body, content));
  return {
      body, sequence, {builder.GetBufferPointer(), builder.GetBufferPointer() + builder.GetSize()}, std::move(payload)};
}

std::size_t sequence_offset(std::span<const std::uint8_t> packet) {
  const wire::Header* header = flatbuffers::GetRoot<wire::Packet>(packet.data())->header();
  return static_cast<std::size_t>(
      reinterpret_cast<const flatbuffers::Table*>(header)->GetAddressOf(wire::Header::VT_SEQUENCE) - packet.data());
}

void set_sequence(EncodedPacket& packet, std::uint64_t sequence) {
  packet.sequence = sequence;
  flatbuffers::WriteScalar(packet.packet.data() + sequence_offset(packet.packet), sequence);
}

ParsedPacket ParsedPacket::parse(std::span<const std::uint8_t> packet, std::span<const std::uint8_t> payload) {
  if (packet.empty() || packet.size() > kMaxPacketBytes) {
    throw StreamError(fmt::format("Packet: {} bytes, 1 to {} are allowed", packet.size(), kMaxPacketBytes));
  }
  if (payload.size() > kMaxPayloadBytes) {
    throw StreamError(
        fmt::format("Packet: payload of {} bytes, at most {} are allowed", payload.size(), kMaxPayloadBytes));
  }
  auto content = std::make_shared<Content>();
  content->packet.resize((packet.size() + 7) / 8);
  std::memcpy(content->packet.data(), packet.data(), packet.size());
  content->payload.assign(payload.begin(), payload.end());
  const auto* bytes = reinterpret_cast<const std::uint8_t*>(content->packet.data());
  flatbuffers::Verifier verifier(bytes, packet.size());
  if (!verifier.VerifyBuffer<wire::Packet>(nullptr)) {
    throw StreamError(fmt::format("Packet: {} bytes that do not verify as a Packet", packet.size()));
  }
  ParsedPacket parsed;
  parsed.root_ = flatbuffers::GetRoot<wire::Packet>(bytes);
  const std::string_view schema = parsed.root_->header()->schema()->string_view();
  if (schema != kSchema) {
    throw StreamError(fmt::format("Packet: schema '{:.40}' where '{}' was expected", schema, kSchema));
  }
  if (parsed.body() == wire::Body::NONE || parsed.body() > wire::Body::MAX) {
    throw StreamError(fmt::format("Packet: unknown body type {}", static_cast<int>(parsed.body())));
  }
  parsed.content_ = std::move(content);
  return parsed;
}

}  // namespace splatbus::stream

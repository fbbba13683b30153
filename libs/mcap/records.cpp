#include "mcap/records.h"

#include <fmt/format.h>
#include <zlib.h>

#include <algorithm>

namespace splatbus::mcap {

std::string_view name_of(Opcode opcode) {
  constexpr std::array<std::string_view, 16> names{"record 0",   "Header",        "Footer",          "Schema",
                                                   "Channel",    "Message",       "Chunk",           "MessageIndex",
                                                   "ChunkIndex", "Attachment",    "AttachmentIndex", "Statistics",
                                                   "Metadata",   "MetadataIndex", "SummaryOffset",   "DataEnd"};
  const auto index = static_cast<std::size_t>(opcode);
  return index < names.size() ? names[index] : "record of an unknown kind";
}

std::uint32_t crc32_of(std::span<const std::byte> bytes, std::uint32_t before) {
  return static_cast<std::uint32_t>(::crc32_z(before, reinterpret_cast<const Bytef*>(bytes.data()), bytes.size()));
}

void Statistics::count(const Message& message) {
  message_start_time = message_count == 0 ? message.log_time : std::min(message_start_time, message.log_time);
  message_end_time = std::max(message_end_time, message.log_time);
  ++message_count;
  ++channel_message_counts[message.channel_id];
}

Encoder& Encoder::raw(std::span<const std::byte> bytes) {
  bytes_.insert(bytes_.end(), bytes.begin(), bytes.end());
  return *this;
}

Encoder& Encoder::map(const StringMap& map) {
  std::size_t bytes = 0;
  for (const auto& [key, value] : map) bytes += 2 * sizeof(std::uint32_t) + key.size() + value.size();
  number(static_cast<std::uint32_t>(bytes));
  for (const auto& [key, value] : map) text(key).text(value);
  return *this;
}

Encoder& Encoder::map(const std::map<std::uint16_t, std::uint64_t>& map) {
  number(static_cast<std::uint32_t>(map.size() * (sizeof(std::uint16_t) + sizeof(std::uint64_t))));
  for (const auto& [key, value] : map) number(key).number(value);
  return *this;
}

Encoder& Encoder::header(const Header& header) {
  return record(Opcode::Header, [&] { text(header.profile).text(header.library); });
}

Encoder& Encoder::schema(const Schema& schema) {
  return record(Opcode::Schema, [&] {
    number(schema.id).text(schema.name).text(schema.encoding);
    number(static_cast<std::uint32_t>(schema.data.size())).raw(schema.data);
  });
}

Encoder& Encoder::channel(const Channel& channel) {
  return record(Opcode::Channel, [&] {
    number(channel.id).number(channel.schema_id).text(channel.topic).text(channel.message_encoding);
    map(channel.metadata);
  });
}

Encoder& Encoder::message(const Message& message) {
  return record(Opcode::Message, [&] {
    number(message.channel_id).number(message.sequence).number(message.log_time).number(message.publish_time);
    raw(message.data);
  });
}

Encoder& Encoder::message_index(std::uint16_t channel_id, std::span<const MessageIndexEntry> entries) {
  return record(Opcode::MessageIndex, [&] {
    number(channel_id).number(static_cast<std::uint32_t>(entries.size() * 2 * sizeof(std::uint64_t)));
    for (const MessageIndexEntry& entry : entries) number(entry.log_time).number(entry.offset);
  });
}

Encoder& Encoder::metadata(const Metadata& metadata) {
  return record(Opcode::Metadata, [&] { text(metadata.name).map(metadata.values); });
}

void Decoder::fail(const std::string& what) const {
  throw Error(fmt::format("{}: {}", where_, what));
}

std::span<const std::byte> Decoder::raw(std::uint64_t count) {
  if (count > bytes_.size()) {
    fail(fmt::format("a field of {} bytes, with {} left in the record", count, bytes_.size()));
  }
  const auto part = bytes_.first(count);
  bytes_ = bytes_.subspan(count);
  return part;
}

std::string Decoder::text() {
  const auto bytes = raw(number<std::uint32_t>());
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

StringMap Decoder::string_map() {
  Decoder entries(raw(number<std::uint32_t>()), where_);
  StringMap map;
  while (!entries.empty()) {
    std::string key = entries.text();
    map[std::move(key)] = entries.text();
  }
  return map;
}

std::map<std::uint16_t, std::uint64_t> Decoder::number_map() {
  Decoder entries(raw(number<std::uint32_t>()), where_);
  std::map<std::uint16_t, std::uint64_t> map;
  while (!entries.empty()) {
    const auto key = entries.number<std::uint16_t>();
    map[key] = entries.number<std::uint64_t>();
  }
  return map;
}

Header Decoder::header() {
  Header header;
  header.profile = text();
  header.library = text();
  return header;
}

Schema Decoder::schema() {
  Schema schema;
  schema.id = number<std::uint16_t>();
  schema.name = text();
  schema.encoding = text();
  const auto data = raw(number<std::uint32_t>());
  schema.data.assign(data.begin(), data.end());
  if (schema.id == 0) fail("its id is 0");
  return schema;
}

Channel Decoder::channel() {
  Channel channel;
  channel.id = number<std::uint16_t>();
  channel.schema_id = number<std::uint16_t>();
  channel.topic = text();
  channel.message_encoding = text();
  channel.metadata = string_map();
  return channel;
}

Message Decoder::message() {
  Message message;
  message.channel_id = number<std::uint16_t>();
  message.sequence = number<std::uint32_t>();
  message.log_time = number<std::uint64_t>();
  message.publish_time = number<std::uint64_t>();
  message.data = rest();
  return message;
}

Metadata Decoder::metadata() {
  Metadata metadata;
  metadata.name = text();
  metadata.values = string_map();
  return metadata;
}

ChunkIndex Decoder::chunk_index() {
  ChunkIndex index;
  index.message_start_time = number<std::uint64_t>();
  index.message_end_time = number<std::uint64_t>();
  index.chunk_start_offset = number<std::uint64_t>();
  index.chunk_length = number<std::uint64_t>();
  index.message_index_offsets = number_map();
  index.message_index_length = number<std::uint64_t>();
  index.compression = text();
  index.compressed_size = number<std::uint64_t>();
  index.uncompressed_size = number<std::uint64_t>();
  return index;
}

Statistics Decoder::statistics() {
  Statistics statistics;
  statistics.message_count = number<std::uint64_t>();
  (void)number<std::uint16_t>();  // schemas and channels are counted where they are read
  (void)number<std::uint32_t>();
  statistics.attachment_count = number<std::uint32_t>();
  statistics.metadata_count = number<std::uint32_t>();
  statistics.chunk_count = number<std::uint32_t>();
  statistics.message_start_time = number<std::uint64_t>();
  statistics.message_end_time = number<std::uint64_t>();
  statistics.channel_message_counts = number_map();
  return statistics;
}

ChunkHead read_chunk_head(Decoder decoder) {
  ChunkHead head;
  head.message_start_time = decoder.number<std::uint64_t>();
  head.message_end_time = decoder.number<std::uint64_t>();
  head.uncompressed_size = decoder.number<std::uint64_t>();
  head.uncompressed_crc = decoder.number<std::uint32_t>();
  head.compression = decoder.text();
  head.records = decoder.raw(decoder.number<std::uint64_t>());
  return head;
}

std::optional<Record> next_record(std::span<const std::byte> bytes, std::size_t& offset, const std::string& where) {
  if (offset == bytes.size()) return std::nullopt;
  const std::size_t begin = offset;
  const std::size_t left = bytes.size() - begin;
  std::uint64_t length = 0;
  if (left >= kRecordHeaderBytes) std::memcpy(&length, bytes.data() + begin + 1, sizeof(length));
  if (left < kRecordHeaderBytes || length > left - kRecordHeaderBytes) {
    throw Error(fmt::format("{}: the record at byte {} leaves it", where, begin));
  }
  offset = begin + kRecordHeaderBytes + length;
  return Record{static_cast<Opcode>(bytes[begin]), begin, bytes.subspan(begin + kRecordHeaderBytes, length)};
}

}  // namespace splatbus::mcap

#pragma once

#include <array>
#include <bit>
#include <concepts>
#include <cstring>
#include <optional>
#include <string_view>

#include "mcap/types.h"

// Records as bytes: what writer and reader share.
namespace splatbus::mcap {

inline constexpr std::array<unsigned char, 8> kMagic{0x89, 'M', 'C', 'A', 'P', '0', '\r', '\n'};
inline constexpr std::size_t kRecordHeaderBytes = 9;  ///< opcode and length
inline constexpr std::size_t kFooterBytes = 20;

enum class Opcode : std::uint8_t {
  Header = 1,
  Footer,
  Schema,
  Channel,
  Message,
  Chunk,
  MessageIndex,
  ChunkIndex,
  Attachment,
  AttachmentIndex,
  Statistics,
  Metadata,
  MetadataIndex,
  SummaryOffset,
  DataEnd
};

[[nodiscard]] std::string_view name_of(Opcode opcode);

/// CRC-32 as zlib has it; `before` continues one.
[[nodiscard]] std::uint32_t crc32_of(std::span<const std::byte> bytes, std::uint32_t before = 0);

/// Appends records to bytes.
class Encoder {
 public:
  explicit Encoder(std::vector<std::byte>& bytes) : bytes_(bytes) {}

  template <std::unsigned_integral T>
  Encoder& number(T value) {
    static_assert(std::endian::native == std::endian::little);
    return raw(std::as_bytes(std::span(&value, 1)));
  }
  Encoder& raw(std::span<const std::byte> bytes);
  Encoder& text(std::string_view text) {
    number(static_cast<std::uint32_t>(text.size()));
    return raw(std::as_bytes(std::span(text)));
  }
  Encoder& map(const StringMap& map);
  Encoder& map(const std::map<std::uint16_t, std::uint64_t>& map);

  /// `write()` appends the record's content.
  template <class Write>
  Encoder& record(Opcode opcode, Write write) {
    number(static_cast<std::uint8_t>(opcode)).number(std::uint64_t{0});
    const std::size_t begin = bytes_.size();
    write();
    const std::uint64_t length = bytes_.size() - begin;
    std::memcpy(bytes_.data() + begin - sizeof(length), &length, sizeof(length));
    return *this;
  }

  Encoder& header(const Header& header);
  Encoder& schema(const Schema& schema);
  Encoder& channel(const Channel& channel);
  Encoder& message(const Message& message);
  Encoder& message_index(std::uint16_t channel_id, std::span<const MessageIndexEntry> entries);
  Encoder& metadata(const Metadata& metadata);

 private:
  std::vector<std::byte>& bytes_;
};

/// Reads fields one by one; throws Error that says where a record ends too early.
class Decoder {
 public:
  /// `where` names file and record, and outlives the decoder.
  Decoder(std::span<const std::byte> bytes, const std::string& where) : bytes_(bytes), where_(where) {}

  template <std::unsigned_integral T>
  T number() {
    T value{};
    std::memcpy(&value, raw(sizeof(T)).data(), sizeof(T));
    return value;
  }
  std::span<const std::byte> raw(std::uint64_t count);
  std::span<const std::byte> rest() { return raw(bytes_.size()); }
  std::string text();
  StringMap string_map();
  std::map<std::uint16_t, std::uint64_t> number_map();

  Header header();
  Schema schema();
  Channel channel();
  Message message();
  Metadata metadata();
  ChunkIndex chunk_index();
  Statistics statistics();

  [[nodiscard]] bool empty() const { return bytes_.empty(); }
  [[noreturn]] void fail(const std::string& what) const;

 private:
  std::span<const std::byte> bytes_;
  const std::string& where_;
};

/// A Chunk record up to its compressed bytes.
struct ChunkHead {
  std::uint64_t message_start_time = 0;
  std::uint64_t message_end_time = 0;
  std::uint64_t uncompressed_size = 0;
  std::uint32_t uncompressed_crc = 0;
  std::string compression;
  std::span<const std::byte> records;
};
[[nodiscard]] ChunkHead read_chunk_head(Decoder decoder);

/// A record within bytes.
struct Record {
  Opcode opcode{};
  std::size_t offset = 0;  ///< of the record in those bytes
  std::span<const std::byte> content;
};

/// Takes the next record off `bytes`, which began at `offset`; nullopt at the end. Throws Error that begins with
/// `where` when the record leaves the bytes.
std::optional<Record> next_record(std::span<const std::byte> bytes, std::size_t& offset, const std::string& where);

}  // namespace splatbus::mcap

#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

// The records of an MCAP file (https://mcap.dev/spec), named as there. Times are nanoseconds on a clock that the
// profile says; offsets count bytes from the start of the file.
namespace splatbus::mcap {

/// Names the file, the record, its offset and what was wrong with it.
class Error : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

using StringMap = std::map<std::string, std::string>;

struct Header {
  std::string profile;
  std::string library;
};

struct Schema {
  std::uint16_t id = 0;  ///< not 0
  std::string name;
  std::string encoding;
  std::vector<std::byte> data;
};

struct Channel {
  std::uint16_t id = 0;
  std::uint16_t schema_id = 0;  ///< 0: none
  std::string topic;
  std::string message_encoding;
  StringMap metadata;
};

/// `data` belongs to whoever hands it out.
struct Message {
  std::uint16_t channel_id = 0;
  std::uint32_t sequence = 0;
  std::uint64_t log_time = 0;
  std::uint64_t publish_time = 0;
  std::span<const std::byte> data;
};

struct ChunkIndex {
  std::uint64_t message_start_time = 0;
  std::uint64_t message_end_time = 0;
  std::uint64_t chunk_start_offset = 0;
  std::uint64_t chunk_length = 0;  ///< of the whole record
  std::map<std::uint16_t, std::uint64_t> message_index_offsets;
  std::uint64_t message_index_length = 0;  ///< of all its message indexes together
  std::string compression;
  std::uint64_t compressed_size = 0;
  std::uint64_t uncompressed_size = 0;
};

struct MessageIndexEntry {
  std::uint64_t log_time = 0;
  std::uint64_t offset = 0;  ///< of the message's record in its uncompressed chunk
};
using MessageIndexes = std::map<std::uint16_t, std::vector<MessageIndexEntry>>;

struct Metadata {
  std::string name;
  StringMap values;
};

struct Statistics {
  std::uint64_t message_count = 0;
  std::uint32_t attachment_count = 0;
  std::uint32_t metadata_count = 0;
  std::uint32_t chunk_count = 0;
  std::uint64_t message_start_time = 0;
  std::uint64_t message_end_time = 0;
  std::map<std::uint16_t, std::uint64_t> channel_message_counts;

  void count(const Message& message);
};

}  // namespace splatbus::mcap

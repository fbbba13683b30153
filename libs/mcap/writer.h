#pragma once

#include <filesystem>
#include <memory>
#include <string_view>

#include "mcap/summary.h"
#include "mcap/types.h"

namespace splatbus::mcap {

/// Where a writer's bytes go, in order.
class Output {
 public:
  virtual ~Output() = default;
  virtual void write(std::span<const std::byte> bytes) = 0;  ///< throws Error
};

/// A new file. Throws Error when it exists already or cannot be made.
[[nodiscard]] std::unique_ptr<Output> create_file(const std::filesystem::path& path);

struct WriterOptions {
  Header header;
  std::size_t chunk_bytes = std::size_t{4} << 20;  ///< a chunk is closed when it has that many
  int compression_level = 1;  ///< of Zstandard, 0: none; a chunk that it does not make smaller is left as it is
};

/// Writes an MCAP file: messages in chunks with their schemas and channels, message indexes, metadata, and at close() a
/// summary. What close_chunk() has written can be read whatever becomes of the process. Keeps one chunk in memory, and
/// an entry a chunk. Not thread-safe. Everything throws Error when the output does.
class Writer {
 public:
  Writer(std::unique_ptr<Output> output, WriterOptions options);
  ~Writer();  ///< without close() the file is left as after a crash
  Writer(const Writer&) = delete;
  Writer& operator=(const Writer&) = delete;

  /// Return the id; at most 65535 of either.
  std::uint16_t add_schema(std::string name, std::string encoding, std::vector<std::byte> data);
  std::uint16_t add_channel(std::uint16_t schema_id, std::string topic, std::string message_encoding,
                            StringMap metadata);

  void write(const Message& message);
  void write(const Metadata& metadata);  ///< closes the chunk
  void close_chunk();
  void close();

  [[nodiscard]] std::uint64_t bytes() const { return offset_ + chunk_.size(); }  ///< so far, the open chunk as it is
  [[nodiscard]] std::size_t open_chunk_bytes() const { return chunk_.size(); }
  [[nodiscard]] const Statistics& statistics() const { return summary_.statistics; }

 private:
  void put(std::span<const std::byte> bytes);
  [[nodiscard]] std::span<const std::byte> compress();
  void write_chunk();

  struct Compressor;
  std::unique_ptr<Output> output_;
  const WriterOptions options_;
  std::unique_ptr<Compressor> compressor_;
  Summary summary_;
  std::uint64_t offset_ = 0;
  std::vector<std::byte> chunk_;       // uncompressed records
  std::vector<std::byte> compressed_;  // kept for its memory
  MessageIndexes indexes_;             // of chunk_
  std::uint64_t chunk_start_time_ = 0, chunk_end_time_ = 0;
  bool closed_ = false;
};

}  // namespace splatbus::mcap

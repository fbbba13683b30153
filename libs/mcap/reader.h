#pragma once

#include <filesystem>
#include <functional>
#include <string>

#include "mcap/records.h"
#include "mcap/summary.h"
#include "mcap/types.h"

namespace splatbus::mcap {

struct ReaderLimits {
  std::uint64_t chunk_bytes = std::uint64_t{5} << 28;    ///< of a chunk, compressed or not: 1.25 GiB
  std::uint64_t summary_bytes = std::uint64_t{1} << 28;  ///< of a summary, and of a record outside of chunks
};

/// Reads a file by its summary. One without a whole summary, as a crash leaves it, is read from its start up to the
/// last whole chunk, without chunks that are damaged. Compression is Zstandard or none; messages that lie in no chunk
/// are not read. Nothing is allocated for a size that the file claims and does not have, and no decompressed chunk
/// exceeds the limit. Not thread-safe.
class Reader {
 public:
  /// Throws Error when the file cannot be read or is no MCAP file.
  explicit Reader(std::filesystem::path path, const ReaderLimits& limits = {});
  ~Reader();
  Reader(const Reader&) = delete;
  Reader& operator=(const Reader&) = delete;

  [[nodiscard]] const Header& header() const { return header_; }
  [[nodiscard]] const Summary& summary() const { return summary_; }
  /// What keeps the file from being complete, with its place in the file; empty when it is.
  [[nodiscard]] const std::string& damage() const { return damage_; }
  /// Where the last whole record before the summary ends.
  [[nodiscard]] std::uint64_t data_end() const { return data_end_; }
  [[nodiscard]] std::uint64_t size() const { return size_; }

  /// Calls `visit` for each message of summary().chunks[chunk], in the file's order; the data is valid within the call.
  /// Returns where they lie. Throws Error when the chunk is not what its checksum says, or a message is of no known
  /// channel.
  MessageIndexes read_chunk(std::size_t chunk, const std::function<void(const Message&)>& visit);

  /// Each Metadata record, in the file's order. Throws Error.
  [[nodiscard]] std::vector<Metadata> read_metadata() const;

 private:
  [[nodiscard]] std::vector<std::byte> read(std::uint64_t offset, std::uint64_t bytes) const;
  [[nodiscard]] std::string at(std::string_view what, std::uint64_t offset) const;
  [[nodiscard]] std::vector<std::byte> read_record(Opcode opcode, std::uint64_t offset, std::uint64_t length,
                                                   std::uint64_t limit) const;
  void read_header();
  [[nodiscard]] bool read_summary();
  /// False where it is neither a schema nor a channel.
  bool take_definition(Opcode opcode, Decoder& record);
  void take_summary(std::span<const std::byte> bytes, std::uint64_t offset);
  void check_indexes() const;
  void scan();
  bool scan_record(std::uint64_t& offset);
  [[nodiscard]] bool follows_last_chunk(std::uint64_t offset) const;
  void scan_chunk(std::uint64_t offset, std::uint64_t length);
  [[nodiscard]] std::span<const std::byte> unpack(const ChunkHead& head, const std::string& where);
  MessageIndexes visit_records(std::span<const std::byte> records, const std::string& where,
                               const std::function<void(const Message&)>& visit);

  struct Decompressor;
  const std::filesystem::path path_;
  const ReaderLimits limits_;
  int descriptor_ = -1;
  std::uint64_t size_ = 0, data_end_ = 0;
  Header header_;
  Summary summary_;
  std::string damage_;
  std::unique_ptr<Decompressor> decompressor_;
  std::vector<std::byte> unpacked_;
};

struct Recovered {
  std::string damage;           ///< what was wrong; empty when nothing was, and nothing was done
  std::uint64_t cut_bytes = 0;  ///< behind the last whole chunk
};

/// Completes a file that a crash has left: cuts it behind the last whole chunk, and writes the summary that was
/// missing. Throws Error as Reader does, and when the file cannot be written.
Recovered recover(const std::filesystem::path& path, const ReaderLimits& limits = {});

}  // namespace splatbus::mcap

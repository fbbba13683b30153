#pragma once

#include "mcap/types.h"

namespace splatbus::mcap {

struct MetadataIndex {
  std::uint64_t offset = 0;
  std::uint64_t length = 0;  ///< of the whole record
  std::string name;
};

/// What a file's summary repeats or says of its data section.
struct Summary {
  std::map<std::uint16_t, Schema> schemas;
  std::map<std::uint16_t, Channel> channels;
  std::vector<ChunkIndex> chunks;
  std::vector<MetadataIndex> metadata;
  Statistics statistics;
};

/// The bytes from the end of the data section, which is at `offset`, to the end of the file: DataEnd, the summary,
/// where its groups are, Footer and magic.
[[nodiscard]] std::vector<std::byte> file_end(const Summary& summary, std::uint64_t offset);

}  // namespace splatbus::mcap

#include "mcap/summary.h"

#include "mcap/records.h"

namespace splatbus::mcap {

namespace {

struct Group {
  Opcode opcode;
  std::uint64_t start, length;
};

void write_chunk_index(Encoder& encoder, const ChunkIndex& index) {
  encoder.record(Opcode::ChunkIndex, [&] {
    encoder.number(index.message_start_time).number(index.message_end_time);
    encoder.number(index.chunk_start_offset).number(index.chunk_length);
    encoder.map(index.message_index_offsets).number(index.message_index_length);
    encoder.text(index.compression).number(index.compressed_size).number(index.uncompressed_size);
  });
}

void write_statistics(Encoder& encoder, const Summary& summary) {
  const Statistics& statistics = summary.statistics;
  encoder.record(Opcode::Statistics, [&] {
    encoder.number(statistics.message_count);
    encoder.number(static_cast<std::uint16_t>(summary.schemas.size()));
    encoder.number(static_cast<std::uint32_t>(summary.channels.size()));
    encoder.number(statistics.attachment_count);
    encoder.number(static_cast<std::uint32_t>(summary.metadata.size()));
    encoder.number(static_cast<std::uint32_t>(summary.chunks.size()));
    encoder.number(statistics.message_start_time).number(statistics.message_end_time);
    encoder.map(statistics.channel_message_counts);
  });
}

}  // namespace

std::vector<std::byte> file_end(const Summary& summary, std::uint64_t offset) {
  std::vector<std::byte> bytes;
  Encoder encoder(bytes);
  encoder.record(Opcode::DataEnd, [&] { encoder.number(std::uint32_t{0}); });  // each chunk has a checksum of its own
  const std::size_t summary_begin = bytes.size();
  std::vector<Group> groups;
  const auto group = [&](Opcode opcode, auto write) {
    const std::size_t begin = bytes.size();
    write();
    if (bytes.size() > begin) groups.push_back({opcode, offset + begin, bytes.size() - begin});
  };
  group(Opcode::Schema, [&] {
    for (const auto& [id, schema] : summary.schemas) encoder.schema(schema);
  });
  group(Opcode::Channel, [&] {
    for (const auto& [id, channel] : summary.channels) encoder.channel(channel);
  });
  group(Opcode::Statistics, [&] { write_statistics(encoder, summary); });
  group(Opcode::ChunkIndex, [&] {
    for (const ChunkIndex& index : summary.chunks) write_chunk_index(encoder, index);
  });
  group(Opcode::MetadataIndex, [&] {
    for (const MetadataIndex& index : summary.metadata) {
      encoder.record(Opcode::MetadataIndex,
                     [&] { encoder.number(index.offset).number(index.length).text(index.name); });
    }
  });
  const std::uint64_t offsets_start = offset + bytes.size();
  for (const Group& of : groups) {
    encoder.record(Opcode::SummaryOffset,
                   [&] { encoder.number(static_cast<std::uint8_t>(of.opcode)).number(of.start).number(of.length); });
  }
  encoder.record(Opcode::Footer, [&] {
    encoder.number(std::uint64_t{offset + summary_begin}).number(offsets_start);
    // Of everything from the summary's start up to here; the footer's own length is not known to the encoder yet.
    const std::uint64_t footer_bytes = kFooterBytes;
    std::memcpy(bytes.data() + bytes.size() - 3 * sizeof(std::uint64_t), &footer_bytes, sizeof(footer_bytes));
    encoder.number(crc32_of(std::span(bytes).subspan(summary_begin)));
  });
  encoder.raw(std::as_bytes(std::span(kMagic)));
  return bytes;
}

}  // namespace splatbus::mcap

#include "mcap/reader.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>
#include <zstd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>

#include "mcap/records.h"

namespace splatbus::mcap {

namespace {

constexpr std::size_t kFileEndBytes = kRecordHeaderBytes + kFooterBytes + kMagic.size();

bool is_magic(std::span<const std::byte> bytes) {
  return std::ranges::equal(bytes, std::as_bytes(std::span(kMagic)));
}

}  // namespace

struct Reader::Decompressor {
  std::unique_ptr<ZSTD_DCtx, decltype(&ZSTD_freeDCtx)> context{ZSTD_createDCtx(), &ZSTD_freeDCtx};
};

Reader::Reader(std::filesystem::path path, const ReaderLimits& limits)
    : path_(std::move(path)), limits_(limits), decompressor_(std::make_unique<Decompressor>()) {
  descriptor_ = ::open(path_.c_str(), O_RDONLY | O_CLOEXEC);
  struct stat status {};
  if (descriptor_ < 0 || ::fstat(descriptor_, &status) != 0) {
    const int error = errno;
    if (descriptor_ >= 0) ::close(descriptor_);
    throw Error(fmt::format("{}: {}", path_.string(), std::strerror(error)));
  }
  try {
    size_ = static_cast<std::uint64_t>(status.st_size);
    if (size_ < kMagic.size() || !is_magic(read(0, kMagic.size()))) {
      throw Error(fmt::format("{}: not an MCAP file", path_.string()));
    }
    read_header();
    if (read_summary()) return;
    summary_ = {};
    scan();
  } catch (...) {
    ::close(descriptor_);
    throw;
  }
}

Reader::~Reader() {
  ::close(descriptor_);
}

std::string Reader::at(std::string_view what, std::uint64_t offset) const {
  return fmt::format("{}: {} at byte {}", path_.string(), what, offset);
}

std::vector<std::byte> Reader::read(std::uint64_t offset, std::uint64_t bytes) const {
  if (offset > size_ || bytes > size_ - offset) {
    throw Error(fmt::format("{}: has {} bytes, not the {} at byte {}", path_.string(), size_, bytes, offset));
  }
  std::vector<std::byte> result(bytes);
  for (std::size_t have = 0; have < bytes;) {
    const ssize_t got = ::pread(descriptor_, result.data() + have, bytes - have, static_cast<off_t>(offset + have));
    if (got < 0 && errno == EINTR) continue;
    if (got <= 0) throw Error(at(got < 0 ? std::strerror(errno) : "the file has become shorter", offset + have));
    have += static_cast<std::size_t>(got);
  }
  return result;
}

std::vector<std::byte> Reader::read_record(Opcode opcode, std::uint64_t offset, std::uint64_t length,
                                           std::uint64_t limit) const {
  const std::string where = at(name_of(opcode), offset);
  if (length < kRecordHeaderBytes || length > limit) {
    throw Error(fmt::format("{}: {} bytes; allowed are {} to {}", where, length, kRecordHeaderBytes, limit));
  }
  const auto bytes = read(offset, length);
  std::uint64_t content = 0;
  std::memcpy(&content, bytes.data() + 1, sizeof(content));
  if (static_cast<Opcode>(bytes[0]) != opcode || content != length - kRecordHeaderBytes) {
    throw Error(
        fmt::format("{}: there is a {} of {} bytes instead", where, name_of(static_cast<Opcode>(bytes[0])), content));
  }
  return {bytes.begin() + kRecordHeaderBytes, bytes.end()};
}

void Reader::read_header() {
  const std::uint64_t offset = kMagic.size();
  const std::string where = at(name_of(Opcode::Header), offset);
  const auto head = read(offset, kRecordHeaderBytes);
  std::uint64_t length = 0;
  std::memcpy(&length, head.data() + 1, sizeof(length));
  if (length > limits_.summary_bytes) throw Error(fmt::format("{}: {} bytes are too many", where, length));
  header_ =
      Decoder(read_record(Opcode::Header, offset, kRecordHeaderBytes + length, limits_.summary_bytes), where).header();
}

// False, with `damage_` saying why, where there is none to go by.
bool Reader::read_summary() try {
  if (size_ < kMagic.size() + kFileEndBytes || !is_magic(read(size_ - kMagic.size(), kMagic.size()))) {
    damage_ = at("no end mark", size_);
    return false;
  }
  const std::uint64_t footer_offset = size_ - kFileEndBytes;
  const std::string where = at("Footer", footer_offset);
  const auto footer = read_record(Opcode::Footer, footer_offset, kRecordHeaderBytes + kFooterBytes, kFileEndBytes);
  Decoder decoder(footer, where);
  const auto start = decoder.number<std::uint64_t>();
  const auto offsets_start = decoder.number<std::uint64_t>();
  const auto crc = decoder.number<std::uint32_t>();
  if (start == 0) {
    damage_ = at("no summary", footer_offset);
    return false;
  }
  if (start < kMagic.size() || start > footer_offset || footer_offset - start > limits_.summary_bytes) {
    decoder.fail(fmt::format("its summary is said to begin at byte {}", start));
  }
  const auto bytes = read(start, size_ - kMagic.size() - sizeof(crc) - start);
  if (crc != 0 && crc != crc32_of(bytes)) throw Error(at("summary", start) + ": its checksum is wrong");
  const std::uint64_t end = offsets_start >= start && offsets_start <= footer_offset ? offsets_start : footer_offset;
  take_summary(std::span(bytes).first(end - start), start);
  check_indexes();
  return true;
} catch (const Error& error) {
  damage_ = error.what();
  return false;
}

bool Reader::take_definition(Opcode opcode, Decoder& record) {
  if (opcode == Opcode::Schema) {
    Schema schema = record.schema();
    summary_.schemas.emplace(schema.id, std::move(schema));
  } else if (opcode == Opcode::Channel) {
    Channel channel = record.channel();
    summary_.channels.emplace(channel.id, std::move(channel));
  }
  return opcode == Opcode::Schema || opcode == Opcode::Channel;
}

void Reader::take_summary(std::span<const std::byte> bytes, std::uint64_t offset) {
  std::string where = at("summary", offset);
  std::size_t position = 0;
  bool has_statistics = false;
  while (const auto record = next_record(bytes, position, where)) {
    const std::string of_record = at(name_of(record->opcode), offset + record->offset);
    Decoder decoder(record->content, of_record);
    if (take_definition(record->opcode, decoder)) continue;
    if (record->opcode == Opcode::ChunkIndex) {
      summary_.chunks.push_back(decoder.chunk_index());
    } else if (record->opcode == Opcode::Statistics) {
      summary_.statistics = decoder.statistics();
      has_statistics = true;
    } else if (record->opcode == Opcode::MetadataIndex) {
      MetadataIndex index;
      index.offset = decoder.number<std::uint64_t>();
      index.length = decoder.number<std::uint64_t>();
      index.name = decoder.text();
      summary_.metadata.push_back(std::move(index));
    }
  }
  if (!has_statistics || (summary_.chunks.empty() && summary_.statistics.message_count > 0)) {
    throw Error(fmt::format("{}: it does not say where the messages are", where));
  }
  data_end_ = offset;
}

void Reader::check_indexes() const {
  // One after the other, so that a small file does not name one record a million times.
  std::uint64_t end = kMagic.size();
  const auto check = [&](Opcode opcode, std::uint64_t offset, std::uint64_t length) {
    if (offset < end || offset > data_end_ || length < kRecordHeaderBytes || length > data_end_ - offset) {
      throw Error(fmt::format("{}: the summary gives it an impossible place, {} bytes long",
                              at(name_of(opcode), offset), length));
    }
    end = offset + length;
  };
  for (const ChunkIndex& index : summary_.chunks) check(Opcode::Chunk, index.chunk_start_offset, index.chunk_length);
  end = kMagic.size();
  for (const MetadataIndex& index : summary_.metadata) check(Opcode::Metadata, index.offset, index.length);
}

void Reader::scan() {
  std::uint64_t offset = kMagic.size();
  data_end_ = offset;
  try {
    while (offset < size_ && scan_record(offset)) {
    }
  } catch (const Error& error) {
    damage_ = error.what();
  }
}

// False at the end of the data section. Throws where the file ends within a record.
bool Reader::scan_record(std::uint64_t& offset) {
  const std::uint64_t begin = offset;
  const auto head = read(begin, std::min<std::uint64_t>(kRecordHeaderBytes, size_ - begin));
  std::uint64_t length = 0;
  if (head.size() == kRecordHeaderBytes) std::memcpy(&length, head.data() + 1, sizeof(length));
  const auto opcode = static_cast<Opcode>(head[0]);
  if (head.size() < kRecordHeaderBytes || length > size_ - begin - kRecordHeaderBytes) {
    throw Error(at(name_of(opcode), begin) + ": the file ends within it");
  }
  if (opcode == Opcode::DataEnd || opcode == Opcode::Footer) return false;
  if (opcode == Opcode{}) throw Error(at(name_of(opcode), begin) + ": there is no such record");
  const std::uint64_t whole = kRecordHeaderBytes + length;
  const std::string where = at(name_of(opcode), begin);
  if (opcode == Opcode::Chunk) {
    scan_chunk(begin, whole);
  } else if (opcode == Opcode::Metadata) {
    const auto content = read_record(opcode, begin, whole, limits_.summary_bytes);
    summary_.metadata.push_back({begin, whole, Decoder(content, where).metadata().name});
  } else if (opcode == Opcode::Schema || opcode == Opcode::Channel) {
    const auto content = read_record(opcode, begin, whole, limits_.summary_bytes);
    Decoder decoder(content, where);
    take_definition(opcode, decoder);
  } else if (opcode == Opcode::MessageIndex && follows_last_chunk(begin)) {
    ChunkIndex& chunk = summary_.chunks.back();
    const auto content = read_record(opcode, begin, whole, limits_.summary_bytes);
    chunk.message_index_offsets[Decoder(content, where).number<std::uint16_t>()] = begin;
    chunk.message_index_length += whole;
  }
  offset = begin + whole;
  data_end_ = offset;
  return true;
}

bool Reader::follows_last_chunk(std::uint64_t offset) const {
  if (summary_.chunks.empty()) return false;
  const ChunkIndex& chunk = summary_.chunks.back();
  return offset == chunk.chunk_start_offset + chunk.chunk_length + chunk.message_index_length;
}

void Reader::scan_chunk(std::uint64_t offset, std::uint64_t length) try {
  const std::string where = at(name_of(Opcode::Chunk), offset);
  const auto content = read_record(Opcode::Chunk, offset, length, limits_.chunk_bytes);
  const ChunkHead head = read_chunk_head(Decoder(content, where));
  const auto records = unpack(head, where);
  Statistics counted = summary_.statistics;
  visit_records(records, where, [&](const Message& message) { counted.count(message); });
  summary_.statistics = std::move(counted);
  summary_.chunks.push_back({.message_start_time = head.message_start_time,
                             .message_end_time = head.message_end_time,
                             .chunk_start_offset = offset,
                             .chunk_length = length,
                             .compression = head.compression,
                             .compressed_size = head.records.size(),
                             .uncompressed_size = head.uncompressed_size});
} catch (const Error& error) {
  damage_ = error.what();
}

std::span<const std::byte> Reader::unpack(const ChunkHead& head, const std::string& where) {
  if (head.uncompressed_size > limits_.chunk_bytes) {
    throw Error(
        fmt::format("{}: {} bytes uncompressed; allowed are {}", where, head.uncompressed_size, limits_.chunk_bytes));
  }
  std::span<const std::byte> records = head.records;
  if (head.compression == "zstd") {
    // Room is made as the bytes come, for a claim costs nothing.
    ZSTD_DCtx_reset(decompressor_->context.get(), ZSTD_reset_session_only);
    ZSTD_inBuffer in{records.data(), records.size(), 0};
    std::size_t have = 0;
    for (std::size_t left = 1; left != 0;) {
      if (have == unpacked_.size()) {
        unpacked_.resize(
            std::min<std::size_t>(std::max<std::size_t>(2 * have, ZSTD_DStreamOutSize()), head.uncompressed_size + 1));
      }
      ZSTD_outBuffer out{unpacked_.data() + have, unpacked_.size() - have, 0};
      left = ZSTD_decompressStream(decompressor_->context.get(), &out, &in);
      if (ZSTD_isError(left) != 0) throw Error(fmt::format("{}: Zstandard: {}", where, ZSTD_getErrorName(left)));
      have += out.pos;
      if (have > head.uncompressed_size || (out.pos == 0 && in.pos == in.size && left != 0)) break;
    }
    records = std::span<const std::byte>(unpacked_).first(have);
  } else if (!head.compression.empty()) {
    throw Error(fmt::format("{}: compression '{}' is not supported, only zstd", where, head.compression.substr(0, 32)));
  }
  if (records.size() != head.uncompressed_size) {
    throw Error(fmt::format("{}: {} bytes uncompressed, not {}", where, records.size(), head.uncompressed_size));
  }
  if (head.uncompressed_crc != 0 && head.uncompressed_crc != crc32_of(records)) {
    throw Error(where + ": its checksum is wrong");
  }
  return records;
}

MessageIndexes Reader::visit_records(std::span<const std::byte> records, const std::string& where,
                                     const std::function<void(const Message&)>& visit) {
  MessageIndexes indexes;
  std::size_t position = 0;
  while (const auto record = next_record(records, position, where)) {
    const std::string of_record = fmt::format("{}, {} at {} of it", where, name_of(record->opcode), record->offset);
    Decoder decoder(record->content, of_record);
    if (take_definition(record->opcode, decoder)) continue;
    if (record->opcode == Opcode::Message) {
      const Message message = decoder.message();
      if (!summary_.channels.contains(message.channel_id)) {
        decoder.fail(fmt::format("there is no channel {}", message.channel_id));
      }
      visit(message);
      indexes[message.channel_id].push_back({message.log_time, record->offset});
    }
  }
  return indexes;
}

MessageIndexes Reader::read_chunk(std::size_t chunk, const std::function<void(const Message&)>& visit) {
  const ChunkIndex& index = summary_.chunks.at(chunk);
  const std::string where = at(name_of(Opcode::Chunk), index.chunk_start_offset);
  const auto content = read_record(Opcode::Chunk, index.chunk_start_offset, index.chunk_length, limits_.chunk_bytes);
  return visit_records(unpack(read_chunk_head(Decoder(content, where)), where), where, visit);
}

std::vector<Metadata> Reader::read_metadata() const {
  std::vector<Metadata> all;
  for (const MetadataIndex& index : summary_.metadata) {
    const std::string where = at(name_of(Opcode::Metadata), index.offset);
    all.push_back(
        Decoder(read_record(Opcode::Metadata, index.offset, index.length, limits_.summary_bytes), where).metadata());
  }
  return all;
}

}  // namespace splatbus::mcap

#include "mcap/writer.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>
#include <zstd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <limits>
#include <utility>

#include "mcap/records.h"

namespace splatbus::mcap {

namespace {

class FileOutput : public Output {
 public:
  explicit FileOutput(const std::filesystem::path& path)
      : path_(path), descriptor_(::open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0644)) {
    if (descriptor_ < 0) fail();
  }
  ~FileOutput() override { ::close(descriptor_); }

  void write(std::span<const std::byte> bytes) override {
    while (!bytes.empty()) {
      const ssize_t written = ::write(descriptor_, bytes.data(), bytes.size());
      if (written < 0 && errno == EINTR) continue;
      if (written < 0) fail();
      bytes = bytes.subspan(static_cast<std::size_t>(written));
    }
  }

 private:
  [[noreturn]] void fail() const { throw Error(fmt::format("{}: {}", path_.string(), std::strerror(errno))); }

  std::filesystem::path path_;
  int descriptor_;
};

}  // namespace

std::unique_ptr<Output> create_file(const std::filesystem::path& path) {
  return std::make_unique<FileOutput>(path);
}

struct Writer::Compressor {
  std::unique_ptr<ZSTD_CCtx, decltype(&ZSTD_freeCCtx)> context{ZSTD_createCCtx(), &ZSTD_freeCCtx};
};

Writer::Writer(std::unique_ptr<Output> output, WriterOptions options)
    : output_(std::move(output)), options_(std::move(options)), compressor_(std::make_unique<Compressor>()) {
  std::vector<std::byte> bytes;
  Encoder(bytes).raw(std::as_bytes(std::span(kMagic))).header(options_.header);
  put(bytes);
}

Writer::~Writer() = default;

void Writer::put(std::span<const std::byte> bytes) {
  output_->write(bytes);
  offset_ += bytes.size();
}

std::uint16_t Writer::add_schema(std::string name, std::string encoding, std::vector<std::byte> data) {
  if (summary_.schemas.size() >= std::numeric_limits<std::uint16_t>::max()) throw Error("more than 65535 schemas");
  const auto id = static_cast<std::uint16_t>(summary_.schemas.size() + 1);
  const auto added = summary_.schemas.emplace(id, Schema{id, std::move(name), std::move(encoding), std::move(data)});
  Encoder(chunk_).schema(added.first->second);
  return id;
}

std::uint16_t Writer::add_channel(std::uint16_t schema_id, std::string topic, std::string message_encoding,
                                  StringMap metadata) {
  if (summary_.channels.size() >= std::numeric_limits<std::uint16_t>::max()) throw Error("more than 65535 channels");
  const auto id = static_cast<std::uint16_t>(summary_.channels.size() + 1);
  const auto added = summary_.channels.emplace(
      id, Channel{id, schema_id, std::move(topic), std::move(message_encoding), std::move(metadata)});
  Encoder(chunk_).channel(added.first->second);
  return id;
}

void Writer::write(const Message& message) {
  const bool first = indexes_.empty();
  chunk_start_time_ = first ? message.log_time : std::min(chunk_start_time_, message.log_time);
  chunk_end_time_ = first ? message.log_time : std::max(chunk_end_time_, message.log_time);
  indexes_[message.channel_id].push_back({message.log_time, chunk_.size()});
  Encoder(chunk_).message(message);
  summary_.statistics.count(message);
  if (chunk_.size() >= options_.chunk_bytes) close_chunk();
}

void Writer::write(const Metadata& metadata) {
  close_chunk();
  std::vector<std::byte> bytes;
  Encoder(bytes).metadata(metadata);
  summary_.metadata.push_back({offset_, bytes.size(), metadata.name});
  put(bytes);
}

void Writer::close_chunk() {
  if (!chunk_.empty()) write_chunk();
}

std::span<const std::byte> Writer::compress() {
  if (options_.compression_level == 0) return chunk_;
  compressed_.resize(std::max(compressed_.size(), ZSTD_compressBound(chunk_.size())));
  const std::size_t size = ZSTD_compressCCtx(compressor_->context.get(), compressed_.data(), compressed_.size(),
                                             chunk_.data(), chunk_.size(), options_.compression_level);
  if (ZSTD_isError(size) != 0) throw Error(fmt::format("Zstandard: {}", ZSTD_getErrorName(size)));
  return size < chunk_.size() ? std::span<const std::byte>(compressed_).first(size) : chunk_;
}

void Writer::write_chunk() {
  const std::span<const std::byte> records = compress();
  ChunkIndex index{.message_start_time = chunk_start_time_,
                   .message_end_time = chunk_end_time_,
                   .chunk_start_offset = offset_,
                   .compression = records.data() == chunk_.data() ? "" : "zstd",
                   .compressed_size = records.size(),
                   .uncompressed_size = chunk_.size()};
  std::vector<std::byte> head;
  Encoder encoder(head);
  encoder.number(static_cast<std::uint8_t>(Opcode::Chunk));
  constexpr std::size_t fixed = 4 * sizeof(std::uint64_t) + 2 * sizeof(std::uint32_t);
  encoder.number(std::uint64_t{fixed + index.compression.size() + records.size()});
  encoder.number(index.message_start_time).number(index.message_end_time).number(index.uncompressed_size);
  encoder.number(crc32_of(chunk_)).text(index.compression).number(index.compressed_size);
  index.chunk_length = head.size() + records.size();
  put(head);
  put(records);

  std::vector<std::byte> message_indexes;
  for (const auto& [channel_id, entries] : indexes_) {
    index.message_index_offsets[channel_id] = offset_ + message_indexes.size();
    Encoder(message_indexes).message_index(channel_id, entries);
  }
  index.message_index_length = message_indexes.size();
  put(message_indexes);
  summary_.chunks.push_back(std::move(index));
  chunk_.clear();
  indexes_.clear();
  chunk_start_time_ = chunk_end_time_ = 0;
}

void Writer::close() {
  if (std::exchange(closed_, true)) return;
  close_chunk();
  put(file_end(summary_, offset_));
}

}  // namespace splatbus::mcap

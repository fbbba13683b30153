#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

#include "mcap/reader.h"
#include "mcap/records.h"

namespace splatbus::mcap {

namespace {

/// The message indexes of the last chunk, where the file ended before they were whole.
std::vector<std::byte> write_indexes(Reader& reader, Summary& summary, std::uint64_t& end) {
  std::vector<std::byte> bytes;
  if (summary.chunks.empty()) return bytes;
  ChunkIndex& chunk = summary.chunks.back();
  const std::uint64_t chunk_end = chunk.chunk_start_offset + chunk.chunk_length;
  if (end != chunk_end + chunk.message_index_length) return bytes;
  end = chunk_end;
  chunk.message_index_offsets.clear();
  for (const auto& [channel_id, entries] : reader.read_chunk(summary.chunks.size() - 1, [](const Message&) {})) {
    chunk.message_index_offsets[channel_id] = end + bytes.size();
    Encoder(bytes).message_index(channel_id, entries);
  }
  chunk.message_index_length = bytes.size();
  return bytes;
}

void replace_end(const std::filesystem::path& path, std::uint64_t end, std::span<const std::byte> bytes) {
  const int descriptor = ::open(path.c_str(), O_WRONLY | O_CLOEXEC);
  bool good = descriptor >= 0 && ::ftruncate(descriptor, static_cast<off_t>(end)) == 0;
  while (good && !bytes.empty()) {
    const ssize_t written = ::pwrite(descriptor, bytes.data(), bytes.size(), static_cast<off_t>(end));
    good = written > 0 || (written < 0 && errno == EINTR);
    if (written <= 0) continue;
    end += static_cast<std::uint64_t>(written);
    bytes = bytes.subspan(static_cast<std::size_t>(written));
  }
  const int error = errno;
  if (descriptor >= 0) ::close(descriptor);
  if (!good) throw Error(fmt::format("{}: {}", path.string(), std::strerror(error)));
}

}  // namespace

Recovered recover(const std::filesystem::path& path, const ReaderLimits& limits) {
  Reader reader(path, limits);
  Recovered result{.damage = reader.damage()};
  if (result.damage.empty()) return result;
  Summary summary = reader.summary();
  result.cut_bytes = reader.size() - reader.data_end();
  std::uint64_t end = reader.data_end();
  std::vector<std::byte> bytes = write_indexes(reader, summary, end);
  const auto rest = file_end(summary, end + bytes.size());
  bytes.insert(bytes.end(), rest.begin(), rest.end());
  replace_end(path, end, bytes);
  return result;
}

}  // namespace splatbus::mcap

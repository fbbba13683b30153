#include "world/segment.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <optional>

#include "world/page_codec.h"

namespace splatbus::world {

namespace {

[[noreturn]] void fail(const std::filesystem::path& path, const char* verb) {
  const int error = errno;
  const std::string what = fmt::format("{}: {}: {}", path.string(), verb, std::strerror(error));
  if (error == ENOSPC || error == EDQUOT || error == EFBIG) throw DiskFull(what);
  throw WorldError(what);
}

/// The header at an offset, where there is one that says so itself.
std::optional<RecordHeader> header_at(std::span<const std::byte> bytes, std::size_t offset) {
  RecordHeader header;
  if (offset + sizeof(header) > bytes.size()) return {};
  std::memcpy(&header, bytes.data() + offset, sizeof(header));
  if (header.magic != RecordHeader::kMagic || header.crc != header_crc(header)) return {};
  const bool known = header.kind >= RecordKind::Page && header.kind <= RecordKind::Commit;
  if (!known || header.length > kMaxPayloadBytes) return {};
  return header;
}

}  // namespace

File::File(const std::filesystem::path& path, int flags)
    : path_(path), descriptor_(::open(path.c_str(), flags | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK, 0644)) {
  if (descriptor_ < 0) fail(path_, "cannot be opened");
}

File::~File() {
  if (descriptor_ >= 0) ::close(descriptor_);
}

std::size_t File::size() const {
  struct stat status {};
  if (::fstat(descriptor_, &status) != 0) fail(path_, "cannot be looked at");
  return static_cast<std::size_t>(status.st_size);
}

bool File::read(std::size_t offset, std::span<std::byte> bytes) const {
  while (!bytes.empty()) {
    const ssize_t n = ::pread(descriptor_, bytes.data(), bytes.size(), static_cast<off_t>(offset));
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) fail(path_, "cannot be read");
    if (n == 0) return false;
    bytes = bytes.subspan(static_cast<std::size_t>(n));
    offset += static_cast<std::size_t>(n);
  }
  return true;
}

void File::write(std::size_t offset, std::span<const std::byte> bytes) const {
  while (!bytes.empty()) {
    const ssize_t n = ::pwrite(descriptor_, bytes.data(), bytes.size(), static_cast<off_t>(offset));
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) fail(path_, "cannot be written");
    bytes = bytes.subspan(static_cast<std::size_t>(n));
    offset += static_cast<std::size_t>(n);
  }
}

void File::truncate(std::size_t bytes) const {
  if (::ftruncate(descriptor_, static_cast<off_t>(bytes)) != 0) fail(path_, "cannot be cut");
}

void File::sync() const {
  if (::fdatasync(descriptor_) != 0) fail(path_, "cannot be brought to disk");
}

void sync_folder(const std::filesystem::path& folder) {
  File(folder, O_RDONLY | O_DIRECTORY).sync();
}

void replace_file(const std::filesystem::path& path, std::span<const std::byte> bytes) {
  std::filesystem::path fresh = path;
  fresh += ".new";
  {
    const File file(fresh, O_WRONLY | O_CREAT | O_TRUNC);
    file.write(0, bytes);
    file.sync();
  }
  if (::rename(fresh.c_str(), path.c_str()) != 0) fail(path, "cannot be replaced");
  sync_folder(path.parent_path());
}

void remove_file(const std::filesystem::path& path) {
  if (::unlink(path.c_str()) != 0 && errno != ENOENT) fail(path, "cannot be removed");
}

std::string Damage::text() const {
  return fmt::format("{} at {}: {}", file, offset, what);
}

bool scan_segment(const File& file, std::uint32_t number, std::uint64_t world_id,
                  const std::function<void(const ScannedRecord&)>& visit, std::vector<Damage>& damage) {
  const std::size_t size = file.size();
  const auto refuse = [&](std::size_t offset, std::string what) {
    damage.push_back({file.path().string(), offset, std::move(what)});
  };
  if (size > kMaxSegmentBytes) {
    refuse(0, fmt::format("{} bytes are more than a segment has", size));
    return false;
  }
  std::vector<std::byte> bytes(size);
  SegmentHeader segment;
  try {
    if (size < sizeof(segment) || !file.read(0, bytes)) {
      refuse(0, "too short for a segment");
      return false;
    }
  } catch (const WorldError& error) {  // a disk that fails here: what lies elsewhere is none the worse
    refuse(0, error.what());
    return false;
  }
  std::memcpy(&segment, bytes.data(), sizeof(segment));
  if (segment.magic != SegmentHeader::kMagic || segment.crc != header_crc(segment) || segment.number != number ||
      segment.version != kFormatVersion || segment.world_id != world_id) {
    refuse(0, "not a segment of this world");
    return false;
  }
  std::size_t at = sizeof(segment);
  std::size_t legible = at;  // nothing is from here to `at`
  while (at < size) {
    const auto header = header_at(bytes, at);
    const std::size_t end = header ? at + sizeof(RecordHeader) + header->length : 0;
    if (!header || end > size) {
      const std::uint32_t magic = RecordHeader::kMagic;
      const void* const next = ::memmem(bytes.data() + at + 1, size - at - 1, &magic, sizeof(magic));
      at = next == nullptr ? size : static_cast<std::size_t>(static_cast<const std::byte*>(next) - bytes.data());
      continue;
    }
    if (at > legible) refuse(legible, fmt::format("{} bytes are not records", at - legible));
    const auto payload = std::span<const std::byte>(bytes).subspan(at + sizeof(RecordHeader), header->length);
    const std::uint32_t crc = crc32_of(payload.data(), payload.size());
    const bool whole = crc == header->payload_crc;
    if (!whole) {
      refuse(at, fmt::format("record {}: checksum {:08x}, not {:08x}", header->sequence, crc, header->payload_crc));
    }
    visit({*header, at, whole, payload});
    at = legible = end;
  }
  if (size > legible) refuse(legible, fmt::format("{} bytes are not records", size - legible));
  return true;
}

}  // namespace splatbus::world

#include "world/manifest.h"

#include <fcntl.h>
#include <fmt/format.h>

#include <cstring>
#include <vector>

#include "world/format.h"
#include "world/page_codec.h"
#include "world/segment.h"

namespace splatbus::world {

namespace {

/// The note follows, and the checksum of all before it.
struct ManifestHeader {
  static constexpr std::uint64_t kMagic = 0x646c726f77627073;  // "spbworld"
  std::uint64_t magic = kMagic;
  std::uint32_t version = kFormatVersion;
  std::uint32_t appearance = 0, sh_degree = 0, rows = 0;
  std::uint64_t world_id = 0, epoch = 0;
  std::uint32_t page_lanes = kPageLanes;
  std::uint32_t note_bytes = 0;
};
static_assert(sizeof(ManifestHeader) == 48);

}  // namespace

std::filesystem::path manifest_path(const std::filesystem::path& folder) {
  return folder / "world.splatbus";
}

Manifest read_manifest(const std::filesystem::path& folder) {
  const File file(manifest_path(folder), O_RDONLY);
  const auto refuse = [&](const std::string& why) -> WorldError {
    return WorldError(fmt::format("{}: {}", file.path().string(), why));
  };
  const std::size_t size = file.size();
  ManifestHeader header;
  if (size < sizeof(header) + sizeof(std::uint32_t) || size > sizeof(header) + kMaxNoteBytes + sizeof(std::uint32_t)) {
    throw refuse(fmt::format("{} bytes are not the manifest of a world", size));
  }
  std::vector<std::byte> bytes(size);
  if (!file.read(0, bytes)) throw refuse("it ends too early");
  std::memcpy(&header, bytes.data(), sizeof(header));
  if (header.magic != ManifestHeader::kMagic) throw refuse("not the manifest of a world");
  if (header.version != kFormatVersion) {
    throw refuse(fmt::format("a world of version {}, not {}", header.version, kFormatVersion));
  }
  std::uint32_t crc = 0;
  std::memcpy(&crc, bytes.data() + size - sizeof(crc), sizeof(crc));
  if (header.note_bytes != size - sizeof(header) - sizeof(crc) || crc != crc32_of(bytes.data(), size - sizeof(crc))) {
    throw refuse("its checksum is wrong");
  }
  Manifest manifest{.layout = {static_cast<Appearance>(header.appearance), static_cast<int>(header.sh_degree)},
                    .world_id = header.world_id,
                    .epoch = header.epoch,
                    .note = {reinterpret_cast<const char*>(bytes.data()) + sizeof(header), header.note_bytes}};
  if (header.appearance > static_cast<std::uint32_t>(Appearance::Radiance) || header.sh_degree > 3 ||
      header.rows != model::used_rows(manifest.layout) || header.page_lanes != kPageLanes) {
    throw refuse("its Gaussians are laid out in a way that this program does not know");
  }
  return manifest;
}

void write_manifest(const std::filesystem::path& folder, const Manifest& manifest) {
  const std::string note = manifest.note.substr(0, kMaxNoteBytes);
  const ManifestHeader header{.appearance = static_cast<std::uint32_t>(manifest.layout.appearance),
                              .sh_degree = static_cast<std::uint32_t>(manifest.layout.sh_degree),
                              .rows = model::used_rows(manifest.layout),
                              .world_id = manifest.world_id,
                              .epoch = manifest.epoch,
                              .note_bytes = static_cast<std::uint32_t>(note.size())};
  std::vector<std::byte> bytes(sizeof(header) + note.size() + sizeof(std::uint32_t));
  std::memcpy(bytes.data(), &header, sizeof(header));
  std::memcpy(bytes.data() + sizeof(header), note.data(), note.size());
  const std::uint32_t crc = crc32_of(bytes.data(), bytes.size() - sizeof(crc));
  std::memcpy(bytes.data() + bytes.size() - sizeof(crc), &crc, sizeof(crc));
  replace_file(manifest_path(folder), bytes);
}

}  // namespace splatbus::world

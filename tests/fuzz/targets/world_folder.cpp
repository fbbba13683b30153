// A world folder: its manifest and one segment, for a reader and for a writer. Checksums are put right first, or no
// change would ever get behind them; the first byte chooses whether those of payloads are, too, and whether a manifest
// goes before the segment.
#include <filesystem>
#include <fstream>

#include "target.h"
#include "world/world.h"

namespace {

namespace world = splatbus::world;
using splatbus::fuzz::Bytes;
using splatbus::fuzz::require;
using Raw = std::vector<std::uint8_t>;

template <class Header>
bool read_header(const Raw& bytes, std::size_t at, Header& header) {
  if (at + sizeof(header) > bytes.size()) return false;
  std::memcpy(&header, bytes.data() + at, sizeof(header));
  return true;
}
template <class Header>
void write_header(Raw& bytes, std::size_t at, Header header) {
  header.crc = world::header_crc(header);
  std::memcpy(bytes.data() + at, &header, sizeof(header));
}

void settle_checksums(Raw& segment, bool payloads) {
  world::SegmentHeader begin;
  if (!read_header(segment, 0, begin)) return;
  world::RecordHeader record;
  for (std::size_t at = sizeof(begin); read_header(segment, at, record);) {
    const std::size_t payload = at + sizeof(record);
    const std::size_t length = std::min<std::size_t>(record.length, segment.size() - payload);
    if (payloads) record.payload_crc = world::crc32_of(segment.data() + payload, length);
    write_header(segment, at, record);
    at = payload + length;
  }
}

void write_file(const std::filesystem::path& path, const Raw& bytes) {
  std::ofstream(path, std::ios::binary | std::ios::trunc)
      .write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
}

/// In memory, where there is such a folder.
class Folder {
 public:
  Folder() {
    const std::filesystem::path memory = "/dev/shm";
    std::string name =
        ((std::filesystem::is_directory(memory) ? memory : std::filesystem::temp_directory_path()) / "fuzz-XXXXXX")
            .string();
    require(::mkdtemp(name.data()) != nullptr, "a folder");
    path_ = name;
    world::World(path_, {.note = "fuzz"}).commit({.step = 1});
    std::ifstream file(world::manifest_path(path_), std::ios::binary);
    manifest_ = {std::istreambuf_iterator<char>(file), {}};
    id_ = world::read_manifest(path_).world_id;
  }
  ~Folder() { std::filesystem::remove_all(path_); }
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;

  /// As it was, with this segment in it alone.
  void fill(const Raw& segment) const {
    for (const auto& entry : std::filesystem::directory_iterator(path_ / "segments")) {
      std::filesystem::remove(entry.path());
    }
    write_file(world::manifest_path(path_), manifest_);
    write_file(path_ / "segments" / "000001.seg", segment);
  }
  [[nodiscard]] const std::filesystem::path& path() const { return path_; }
  [[nodiscard]] std::uint64_t id() const { return id_; }

 private:
  std::filesystem::path path_;
  Raw manifest_;
  std::uint64_t id_ = 0;
};

void read_all(world::World& folder) {
  for (const auto& [key, entry] : folder.pages()) {
    const auto page = folder.read(key);
    require(!page || (page->count == entry.count && page->key == key), "a page is what its entry says");
  }
  (void)folder.damage();
}

}  // namespace

SPLATBUS_FUZZ_TARGET(world_folder, bytes) {
  static const Folder folder;
  splatbus::fuzz::Input input(bytes);
  const auto choice = input.number();
  Bytes manifest;
  if ((choice & 1U) != 0) manifest = input.take(input.number<std::uint16_t>());
  const Bytes rest = input.rest();
  Raw segment(rest.begin(), rest.end());
  world::SegmentHeader begin;
  if (read_header(segment, 0, begin)) {
    begin.world_id = folder.id();
    write_header(segment, 0, begin);
  }
  settle_checksums(segment, (choice & 2U) == 0);
  folder.fill(segment);
  if (!manifest.empty()) write_file(world::manifest_path(folder.path()), {manifest.begin(), manifest.end()});
  try {
    world::World reader(folder.path());
    read_all(reader);
  } catch (const world::WorldError&) {  // refused
  }
  try {
    world::World writer(folder.path(), {.sync = [](const world::File&) {}});
    read_all(writer);
    writer.commit({.step = 9}, false);
    while (writer.compact()) {
    }
    require(writer.progress().step == 9, "what is committed is there");
  } catch (const world::WorldError&) {  // refused
  }
}

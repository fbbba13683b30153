#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "world/format.h"

namespace splatbus::world {

/// An open file, shared by whoever reads it: its bytes stay readable after it has been unlinked. Throws WorldError that
/// names it.
class File {
 public:
  /// `flags` of open(2).
  File(const std::filesystem::path& path, int flags);
  ~File();
  File(const File&) = delete;
  File& operator=(const File&) = delete;

  [[nodiscard]] const std::filesystem::path& path() const { return path_; }
  [[nodiscard]] int descriptor() const { return descriptor_; }
  [[nodiscard]] std::size_t size() const;
  /// False when the file ends before.
  [[nodiscard]] bool read(std::size_t offset, std::span<std::byte> bytes) const;
  void write(std::size_t offset, std::span<const std::byte> bytes) const;
  void truncate(std::size_t bytes) const;
  void sync() const;  ///< fdatasync

 private:
  std::filesystem::path path_;
  int descriptor_ = -1;
};

/// Makes what was made, renamed or removed in a folder last. Throws WorldError.
void sync_folder(const std::filesystem::path& folder);
/// Writes a file anew: it is the old one or the new one for whoever reads it, after a crash, too.
void replace_file(const std::filesystem::path& path, std::span<const std::byte> bytes);

/// Nothing where there is none.
void remove_file(const std::filesystem::path& path);

/// A place where something is not what was written.
struct Damage {
  std::string file;
  std::size_t offset = 0;
  std::string what;
  [[nodiscard]] std::string text() const;
};

struct ScannedRecord {
  RecordHeader header;
  std::size_t offset = 0;              ///< of the header in its file
  bool whole = true;                   ///< the payload's checksum is right
  std::span<const std::byte> payload;  ///< until the visitor returns
};

/// Goes through a segment: what has a right header is visited in order, and what is between is damage. Returns whether
/// it is one of `world_id` at all; else nothing was visited.
bool scan_segment(const File& file, std::uint32_t number, std::uint64_t world_id,
                  const std::function<void(const ScannedRecord&)>& visit, std::vector<Damage>& damage);

}  // namespace splatbus::world

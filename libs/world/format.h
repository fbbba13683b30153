#pragma once

#include <bit>
#include <compare>
#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "model/channels.h"

// The bytes of a world folder, little-endian. docs/world-folder.md writes them out.
namespace splatbus::world {

static_assert(std::endian::native == std::endian::little, "structs are written as they lie in memory");

inline constexpr std::uint32_t kFormatVersion = 1;
inline constexpr std::size_t kSegmentBytes = std::size_t{64} << 20U;
/// Nothing is a segment that is larger than this, nothing a record that has more behind its header.
inline constexpr std::size_t kMaxSegmentBytes = std::size_t{80} << 20U;
inline constexpr std::size_t kMaxPayloadBytes = std::size_t{1} << 20U;
inline constexpr std::size_t kMaxNoteBytes = 1024;

/// A page's place in the order of its world: its frame of reference and its first key. No two pages share one.
struct PageKey {
  std::uint32_t frame_id = kWorldFrame;
  std::uint32_t level = 0;
  std::uint64_t morton = 0, id = 0;
  auto operator<=>(const PageKey&) const = default;
};

enum class RecordKind : std::uint32_t {
  Page = 1,     ///< what the page of that key is from now on
  Removal = 2,  ///< there is no page of that key any more
  Mark = 3,     ///< the page of that key is the same, but where it lies is another (PageMark)
  Commit = 4,   ///< all records since the last commit take effect
};

/// Whether a page of the folder is in a trainer's memory, too.
enum class PageMark : std::uint32_t {
  Resident = 0,
  Spilled = 1,  ///< it is in the folder alone
  Fetched = 2,  ///< it was, and is on its way back to memory or there already
};

struct SegmentHeader {
  static constexpr std::uint64_t kMagic = 0x6765736462777073;  // "spwbdseg"
  std::uint64_t magic = kMagic;
  std::uint32_t version = kFormatVersion;
  std::uint32_t number = 0;
  std::uint64_t world_id = 0;
  std::uint32_t reserved = 0;
  std::uint32_t crc = 0;  ///< of the bytes before
};
static_assert(sizeof(SegmentHeader) == 32);

struct RecordHeader {
  static constexpr std::uint32_t kMagic = 0x43455253;  // "SREC"
  std::uint32_t magic = kMagic;
  RecordKind kind = RecordKind::Commit;
  std::uint32_t length = 0;  ///< of the payload, bytes
  std::uint32_t payload_crc = 0;
  std::uint64_t sequence = 0;  ///< ascends from record to record, across segments
  PageKey key;                 ///< 0 for a commit
  std::uint32_t mark = 0;      ///< PageMark of a page or a mark
  std::uint32_t reserved[2] = {0, 0};
  std::uint32_t crc = 0;  ///< of the bytes before
};
static_assert(sizeof(RecordHeader) == 64);

/// Begins the payload of a page; a Zstandard frame of its channels follows.
struct PageHeader {
  std::uint32_t count = 0;  ///< Gaussians, 1 to kPageLanes
  std::uint32_t rows = 0;   ///< of 4-byte words
  std::uint32_t state = 0;  ///< model::PageState
  float low_m[3] = {0, 0, 0}, high_m[3] = {0, 0, 0}, max_scale_m = 0;
  std::uint64_t step = 0;         ///< at which it was copied
  std::uint64_t morton_last = 0;  ///< the highest Morton key of its Gaussians
};
static_assert(sizeof(PageHeader) == 56);

/// Payload of a commit: the model as a whole.
struct WorldProgress {
  std::uint64_t next_gaussian_id = 1;
  std::uint64_t step = 0, views = 0;
  double optimizer_s = 0;
  std::uint64_t generation = 0;  ///< of the structure, while that trainer lived
  bool operator==(const WorldProgress&) const = default;
};
static_assert(sizeof(WorldProgress) == 40);

static_assert(std::is_trivially_copyable_v<SegmentHeader> && std::is_trivially_copyable_v<RecordHeader> &&
              std::is_trivially_copyable_v<PageHeader> && std::is_trivially_copyable_v<WorldProgress>);

/// CRC-32 of zlib, PNG and Ethernet.
[[nodiscard]] std::uint32_t crc32_of(const void* bytes, std::size_t count);

/// Of a header that ends with its own checksum.
template <class Header>
[[nodiscard]] std::uint32_t header_crc(const Header& header) {
  static_assert(offsetof(Header, crc) + sizeof(header.crc) == sizeof(Header));
  return crc32_of(&header, offsetof(Header, crc));
}

}  // namespace splatbus::world

#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <stdexcept>
#include <vector>

#include "gaussians/layout.h"
#include "gaussians/pages.h"
#include "model/page_table.h"
#include "world/format.h"

namespace splatbus::world {

/// What a folder cannot be read or written for; what() names the file.
class WorldError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// The disk takes no more.
class DiskFull : public WorldError {
 public:
  using WorldError::WorldError;
};

/// A page by itself, in host memory.
struct Page {
  PageKey key;
  PageMark mark = PageMark::Resident;
  model::PageState state = model::PageState::Active;
  std::uint32_t count = 0;        ///< Gaussians
  std::uint64_t step = 0;         ///< at which it was copied
  std::uint64_t morton_last = 0;  ///< highest Morton key of its Gaussians
  PageBounds bounds;
  /// Rows of model/channels.h, [rows][count]; a channel of two words has [count] of 8 bytes in their place.
  std::vector<std::uint32_t> words;
};

/// The payload of a page's record: what is lossless in fewer bytes. Parameters first, the average over time as its
/// difference from them, bytes of one place in their words together, by Zstandard.
[[nodiscard]] std::vector<std::byte> encode_page(const Page& page, const ParameterLayout& layout);

/// Everything but the words, and these when the checksum was right. Bounds every size before it takes memory. Throws
/// WorldError that begins with `what`.
[[nodiscard]] PageHeader read_page_header(std::span<const std::byte> payload, const ParameterLayout& layout,
                                          const char* what);
[[nodiscard]] Page decode_page(std::span<const std::byte> payload, const ParameterLayout& layout, const PageKey& key,
                               const char* what);

}  // namespace splatbus::world

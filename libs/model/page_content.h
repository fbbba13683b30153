#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "gaussians/layout.h"
#include "model/page_table.h"

namespace splatbus::model {

/// A page that is nowhere in a store, in host memory: its channels without the lanes that hold nothing, used_rows()
/// rows of [structure.count] words; a channel of two words has [structure.count] of 8 bytes in their place.
struct PageContent {
  PageStructure structure;
  std::span<const std::uint32_t> words;
};

[[nodiscard]] std::size_t content_words(const ParameterLayout& layout, std::uint32_t count);

/// A page's block without the lanes that hold nothing.
void pack_page(const ParameterLayout& layout, const std::uint32_t* block, std::uint32_t count, std::uint32_t* words);
/// The other way, for those of its lanes.
void unpack_page(const ParameterLayout& layout, const PageContent& page, std::span<const std::uint32_t> lanes,
                 std::uint32_t* block);

/// The lanes whose Gaussians are finite and have an id from 1 up to below `next_gaussian_id`.
[[nodiscard]] std::vector<std::uint32_t> sound_lanes(const ParameterLayout& layout, const PageContent& page,
                                                     std::uint64_t next_gaussian_id);
/// Of the lane's Gaussian.
[[nodiscard]] std::uint64_t id_of(const ParameterLayout& layout, const PageContent& page, std::uint32_t lane);
/// The highest key of the page's Gaussians: of where their samples were.
[[nodiscard]] std::uint64_t last_morton_key(const ParameterLayout& layout, const PageContent& page);

}  // namespace splatbus::model

#include "model/page_content.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>

#include "model/channels.h"
#include "model/page_kernels.h"

namespace splatbus::model {

namespace {

const std::uint32_t* channel(const ParameterLayout& layout, const PageContent& page, Channel which) {
  return page.words.data() + std::size_t{rows_of(which, layout).first} * page.structure.count;
}

}  // namespace

std::size_t content_words(const ParameterLayout& layout, std::uint32_t count) {
  return std::size_t{used_rows(layout)} * count;
}

void pack_page(const ParameterLayout& layout, const std::uint32_t* block, std::uint32_t count, std::uint32_t* words) {
  for (const Channel which : kChannels) {
    const ChannelRows rows = rows_of(which, layout);
    const bool wide = rows.type == ChannelType::U64;
    const std::uint32_t arrays = wide ? 1 : rows.rows, row_words = wide ? 2 * count : count;
    for (std::uint32_t a = 0; a < arrays; ++a) {
      std::memcpy(words + std::size_t{rows.first + a} * count, block + std::size_t{rows.first + a} * kRowWords,
                  row_words * sizeof(std::uint32_t));
    }
  }
}

void unpack_page(const ParameterLayout& layout, const PageContent& page, std::span<const std::uint32_t> lanes,
                 std::uint32_t* block) {
  for (const Channel which : kChannels) {
    const ChannelRows rows = rows_of(which, layout);
    const bool wide = rows.type == ChannelType::U64;
    const std::size_t words_each = wide ? 2 : 1;
    for (std::uint32_t a = 0; a < (wide ? 1 : rows.rows); ++a) {
      const std::uint32_t* const from = page.words.data() + std::size_t{rows.first + a} * page.structure.count;
      std::uint32_t* const to = block + std::size_t{rows.first + a} * kRowWords;
      for (std::size_t k = 0; k < lanes.size(); ++k) {
        std::copy_n(from + lanes[k] * words_each, words_each, to + k * words_each);
      }
    }
  }
}

std::uint64_t id_of(const ParameterLayout& layout, const PageContent& page, std::uint32_t lane) {
  std::uint64_t id = 0;
  std::memcpy(&id, channel(layout, page, Channel::GaussianId) + std::size_t{2} * lane, sizeof(id));
  return id;
}

std::vector<std::uint32_t> sound_lanes(const ParameterLayout& layout, const PageContent& page,
                                       std::uint64_t next_gaussian_id) {
  const std::uint32_t count = page.structure.count, rows = rows_of(Channel::GaussianId, layout).first;
  std::vector<std::uint8_t> broken(count, 0);
  for (std::uint32_t row = 0; row < rows; ++row) {
    constexpr std::uint32_t kExponent = 0x7F800000;
    const std::uint32_t* const words = page.words.data() + std::size_t{row} * count;
    for (std::uint32_t lane = 0; lane < count; ++lane) broken[lane] |= (words[lane] & kExponent) == kExponent ? 1 : 0;
  }
  std::vector<std::uint32_t> lanes;
  for (std::uint32_t lane = 0; lane < count; ++lane) {
    const std::uint64_t id = id_of(layout, page, lane);
    if (broken[lane] == 0 && id > 0 && id < next_gaussian_id) lanes.push_back(lane);
  }
  return lanes;
}

std::uint64_t last_morton_key(const ParameterLayout& layout, const PageContent& page) {
  const std::uint32_t count = page.structure.count;
  const std::uint32_t* const at = channel(layout, page, Channel::SurfacePoint);
  std::uint64_t last = page.structure.morton_first;
  for (std::uint32_t lane = 0; lane < count; ++lane) {
    last = std::max(last, morton_key({std::bit_cast<float>(at[lane]), std::bit_cast<float>(at[count + lane]),
                                      std::bit_cast<float>(at[2 * count + lane])}));
  }
  return last;
}

}  // namespace splatbus::model

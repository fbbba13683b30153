#include "world/page_codec.h"

#include <fmt/format.h>
#include <zlib.h>
#include <zstd.h>

#include <cstring>

namespace splatbus::world {

namespace {

/// Fast: 3 GB of model are a minute of one core, and level 3 saves 2 % more.
constexpr int kZstdLevel = 1;

using model::Channel;
using model::rows_of;

std::uint32_t zigzag(std::uint32_t difference) {
  return difference << 1U ^ (0U - (difference >> 31U));
}
std::uint32_t unzigzag(std::uint32_t value) {
  return value >> 1U ^ (0U - (value & 1U));
}

/// Average words: the difference of two near floats' bits is a small integer.
template <class Change>
void change_average(std::span<std::uint32_t> words, std::uint32_t count, const ParameterLayout& layout,
                    const Change& change) {
  const model::ChannelRows average = rows_of(Channel::Average, layout);
  const std::size_t first = std::size_t{average.first} * count, values = std::size_t{average.rows} * count;
  for (std::size_t i = 0; i < values; ++i) words[first + i] = change(words[first + i], words[i]);
}

}  // namespace

std::uint32_t crc32_of(const void* bytes, std::size_t count) {
  return static_cast<std::uint32_t>(crc32_z(0, static_cast<const Bytef*>(bytes), count));
}

std::vector<std::byte> encode_page(const Page& page, const ParameterLayout& layout) {
  std::vector<std::uint32_t> words = page.words;
  change_average(words, page.count, layout,
                 [](std::uint32_t average, std::uint32_t parameter) { return zigzag(average - parameter); });
  const std::size_t n = words.size();
  std::vector<std::byte> shuffled(n * sizeof(std::uint32_t));
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t k = 0; k < sizeof(std::uint32_t); ++k) {
      shuffled[k * n + i] = static_cast<std::byte>(words[i] >> (8 * k));
    }
  }
  PageHeader header{.count = page.count,
                    .rows = model::used_rows(layout),
                    .state = static_cast<std::uint32_t>(page.state),
                    .low_m = {page.bounds.low.x, page.bounds.low.y, page.bounds.low.z},
                    .high_m = {page.bounds.high.x, page.bounds.high.y, page.bounds.high.z},
                    .max_scale_m = page.bounds.max_scale_m,
                    .step = page.step,
                    .morton_last = page.morton_last};
  std::vector<std::byte> payload(sizeof(header) + ZSTD_compressBound(shuffled.size()));
  std::memcpy(payload.data(), &header, sizeof(header));
  const std::size_t size = ZSTD_compress(payload.data() + sizeof(header), payload.size() - sizeof(header),
                                         shuffled.data(), shuffled.size(), kZstdLevel);
  if (ZSTD_isError(size) != 0) throw WorldError(fmt::format("zstd: {}", ZSTD_getErrorName(size)));
  payload.resize(sizeof(header) + size);
  return payload;
}

PageHeader read_page_header(std::span<const std::byte> payload, const ParameterLayout& layout, const char* what) {
  PageHeader header;
  if (payload.size() < sizeof(header)) throw WorldError(fmt::format("{}: too short for a page", what));
  std::memcpy(&header, payload.data(), sizeof(header));
  if (header.count == 0 || header.count > kPageLanes || header.rows != model::used_rows(layout)) {
    throw WorldError(
        fmt::format("{}: {} Gaussians of {} rows are not a page of this world", what, header.count, header.rows));
  }
  const auto state = static_cast<model::PageState>(header.state);
  if (state != model::PageState::Active && state != model::PageState::Frozen) {
    throw WorldError(fmt::format("{}: {} is not the state of a page that is kept", what, header.state));
  }
  return header;
}

Page decode_page(std::span<const std::byte> payload, const ParameterLayout& layout, const PageKey& key,
                 const char* what) {
  const PageHeader header = read_page_header(payload, layout, what);
  const std::size_t n = std::size_t{header.rows} * header.count;
  const std::span<const std::byte> frame = payload.subspan(sizeof(header));
  std::vector<std::byte> shuffled(n * sizeof(std::uint32_t));
  const std::size_t size = ZSTD_decompress(shuffled.data(), shuffled.size(), frame.data(), frame.size());
  if (ZSTD_isError(size) != 0) throw WorldError(fmt::format("{}: zstd: {}", what, ZSTD_getErrorName(size)));
  if (size != shuffled.size()) throw WorldError(fmt::format("{}: {} bytes of {}", what, size, shuffled.size()));
  Page page{.key = key,
            .state = static_cast<model::PageState>(header.state),
            .count = header.count,
            .step = header.step,
            .morton_last = header.morton_last,
            .bounds = {.low = {header.low_m[0], header.low_m[1], header.low_m[2]},
                       .high = {header.high_m[0], header.high_m[1], header.high_m[2]},
                       .max_scale_m = header.max_scale_m}};
  page.words.resize(n);
  for (std::size_t i = 0; i < n; ++i) {
    std::uint32_t word = 0;
    for (std::size_t k = 0; k < sizeof(word); ++k)
      word |= std::to_integer<std::uint32_t>(shuffled[k * n + i]) << (8 * k);
    page.words[i] = word;
  }
  change_average(page.words, page.count, layout,
                 [](std::uint32_t difference, std::uint32_t parameter) { return parameter + unzigzag(difference); });
  return page;
}

}  // namespace splatbus::world

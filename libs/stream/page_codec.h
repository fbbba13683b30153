#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "stream/bytes.h"
#include "stream/quantized.h"

// Pages of Gaussians as blobs that each stand for themselves: docs/page-codec.md has the bytes. Encoder and decoders
// are in files of their own, so that a viewer links the decoders alone.
namespace splatbus::stream {

/// Part of the wire: numbers stay.
enum class PageCodec : std::uint8_t {
  Draco = 0,   ///< encode_chunk()'s point cloud, and the ids
  Planes = 1,  ///< our own
};

/// In one blob; checked before anything is allocated.
inline constexpr std::size_t kMaxPageGaussians = 4096;

/// True for a number that decode_page() knows.
[[nodiscard]] constexpr bool is_page_codec(std::uint8_t number) {
  return number <= static_cast<std::uint8_t>(PageCodec::Planes);
}

struct PageOptions {
  bool ids = true;  ///< whether Gaussian ids travel; else the decoder gives 0
  /// The blob's lanes are the columns as they are. Planes code how that differs from page_order(), Draco takes any
  /// order for its own.
  bool keep_order = false;
  /// mean_origin() of the page that the columns are a part of: its page_order() is then theirs, too.
  std::optional<std::array<std::int32_t, 3>> origin;
};

struct PageBlob {
  Bytes bytes;
  /// [count] of lanes: lane i of the blob is column order[i] of what was encoded. A permutation.
  std::vector<std::uint32_t> order;
};

/// All columns of `page`, 0 to kMaxPageGaussians of them, every value within the layout's limits. Lossless:
/// decode_page() gives page.gather(order). Safe from any thread.
[[nodiscard]] PageBlob encode_page(const QuantizedGaussians& page, const StreamLayout& layout, PageCodec codec,
                                   const PageOptions& options = {});

/// The order in which the columns cost least: encode_page() without keep_order gives it, and keeping it costs nothing.
[[nodiscard]] std::vector<std::uint32_t> page_order(const QuantizedGaussians& page, const StreamLayout& layout,
                                                    PageCodec codec);
/// The least mean, axis by axis. Asserts that there is one.
[[nodiscard]] std::array<std::int32_t, 3> mean_origin(const QuantizedGaussians& page, const StreamLayout& layout);

/// Throws StreamError unless the bytes are a blob of that codec with exactly `count` Gaussians of this layout, every
/// value within its limits. Allocates no more than `count`, at most kMaxPageGaussians, allows. Safe from any thread.
[[nodiscard]] QuantizedGaussians decode_page(std::span<const std::uint8_t> bytes, const StreamLayout& layout,
                                             PageCodec codec, std::size_t count);

}  // namespace splatbus::stream

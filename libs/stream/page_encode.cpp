#include <cassert>
#include <numeric>

#include "stream/codecs.h"
#include "stream/page_codec_parts.h"

namespace splatbus::stream {

PageBlob encode_draco(const QuantizedGaussians& page, const StreamLayout& layout, const PageOptions& options) {
  std::vector<std::uint32_t> all(page.count());
  std::iota(all.begin(), all.end(), 0U);
  PageBlob blob{{}, options.keep_order ? all : morton_order(page, layout, all)};
  const QuantizedGaussians lanes = page.gather(blob.order);
  const Bytes chunk = encode_chunk(lanes, layout);
  const Payload ids = options.ids ? encode_ids(lanes.gaussian_id) : Payload{};
  for (std::uint64_t number : {std::uint64_t{chunk.size()}, std::uint64_t{ids.raw_bytes}}) {
    for (; number >= 0x80; number >>= 7U) blob.bytes.push_back(static_cast<std::uint8_t>(number | 0x80U));
    blob.bytes.push_back(static_cast<std::uint8_t>(number));
  }
  blob.bytes.insert(blob.bytes.end(), chunk.begin(), chunk.end());
  blob.bytes.insert(blob.bytes.end(), ids.bytes.begin(), ids.bytes.end());
  return blob;
}

PageBlob encode_page(const QuantizedGaussians& page, const StreamLayout& layout, PageCodec codec,
                     const PageOptions& options) {
  assert(page.count() <= kMaxPageGaussians && page.channels.size() == static_cast<std::size_t>(layout.channels()));
  if (page.count() == 0) return {};
  return codec == PageCodec::Draco ? encode_draco(page, layout, options) : encode_planes(page, layout, options);
}

}  // namespace splatbus::stream

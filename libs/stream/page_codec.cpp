#include "stream/page_codec.h"

#include <fmt/format.h>

#include <numeric>

#include "stream/codecs.h"

namespace splatbus::stream {

namespace {

void require(PageCodec codec, std::size_t count) {
  if (codec != PageCodec::Draco) throw StreamError(fmt::format("page: codec {} is not known", static_cast<int>(codec)));
  if (count > kMaxPageGaussians) {
    throw StreamError(fmt::format("page: {} Gaussians, at most {} are possible", count, kMaxPageGaussians));
  }
}

}  // namespace

PageBlob encode_page(const QuantizedGaussians& page, const StreamLayout& layout, PageCodec codec, const PageOptions&) {
  require(codec, page.count());
  PageBlob blob;
  blob.order.resize(page.count());
  std::iota(blob.order.begin(), blob.order.end(), 0U);
  if (page.count() > 0) blob.bytes = encode_chunk(page, layout);
  return blob;
}

QuantizedGaussians decode_page(std::span<const std::uint8_t> bytes, const StreamLayout& layout, PageCodec codec,
                               std::size_t count) {
  require(codec, count);
  if (count > 0) return decode_chunk(bytes, layout, count);
  if (!bytes.empty()) throw StreamError("page: bytes of no Gaussians");
  return QuantizedGaussians(layout);
}

}  // namespace splatbus::stream

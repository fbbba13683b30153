#include <fmt/format.h>

#include "stream/codecs.h"
#include "stream/page_codec_parts.h"

namespace splatbus::stream {

QuantizedGaussians decode_draco(std::span<const std::uint8_t> bytes, const StreamLayout& layout, std::size_t count) {
  constexpr std::string_view what = "Page";
  ByteReader reader(bytes, what);
  const std::uint64_t chunk = reader.varint();
  const std::uint64_t raw_bytes = reader.varint();
  if (chunk > reader.left()) throw StreamError(fmt::format("{}: parts that are longer than it is", what));
  const auto parts = bytes.last(reader.left());
  QuantizedGaussians page = decode_chunk(parts.first(chunk), layout, count);
  const auto ids = parts.subspan(chunk);
  if (!ids.empty()) {
    page.gaussian_id = decode_ids(ids, raw_bytes, count);
  } else if (raw_bytes != 0) {
    throw StreamError(fmt::format("{}: ends before its ids", what));
  }
  return page;
}

QuantizedGaussians decode_page(std::span<const std::uint8_t> bytes, const StreamLayout& layout, PageCodec codec,
                               std::size_t count) {
  if (count > kMaxPageGaussians) {
    throw StreamError(fmt::format("Page: {} Gaussians, at most {} are possible", count, kMaxPageGaussians));
  }
  if (count == 0) {
    if (!bytes.empty()) throw StreamError("Page: bytes for no Gaussians");
    return QuantizedGaussians(layout, 0);
  }
  // No value takes more, with all that is told of its plane.
  const std::size_t most = (count + 64) * (static_cast<std::size_t>(layout.channels()) + 8) * 16;
  if (bytes.size() > most) {
    throw StreamError(fmt::format("Page: {} bytes, at most {} are possible", bytes.size(), most));
  }
  switch (codec) {
    case PageCodec::Draco:
      return decode_draco(bytes, layout, count);
    case PageCodec::Planes:
      return decode_planes(bytes, layout, count);
  }
  throw StreamError(fmt::format("Page: unknown codec {}", static_cast<int>(codec)));
}

}  // namespace splatbus::stream

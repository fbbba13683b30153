// Blobs of pages from nobody knows whom. The first byte chooses codec and layout, two more the count.
#include "stream/page_codec.h"

#include "stream_layouts.h"
#include "target.h"

namespace stream = splatbus::stream;

SPLATBUS_FUZZ_TARGET(page_codec, bytes) {
  splatbus::fuzz::Input input(bytes);
  const auto choice = input.number();
  const stream::StreamLayout& layout = splatbus::fuzz::layout(choice >> 1U);
  const auto codec = static_cast<stream::PageCodec>(choice & 1U);
  const std::size_t count = input.number<std::uint16_t>();
  try {
    const stream::QuantizedGaussians page = stream::decode_page(input.rest(), layout, codec, count);
    splatbus::fuzz::require(page.count() == count && count <= stream::kMaxPageGaussians, "as many as it says");
    splatbus::fuzz::require_within_limits(page, layout);
  } catch (const stream::StreamError&) {  // refused
  }
}

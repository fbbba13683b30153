// libFuzzer: blobs of pages from nobody knows whom. The first byte chooses codec and layout, two more the count.
#include <cstdlib>
#include <span>

#include "stream/page_codec.h"

namespace stream = splatbus::stream;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const stream::StreamLayout layouts[] = {stream::StreamLayout({splatbus::Appearance::Transfer, 3}, 1.0F / 1024),
                                                 stream::StreamLayout({splatbus::Appearance::Radiance, 0}, 1.0F / 1024),
                                                 stream::StreamLayout({splatbus::Appearance::Radiance, 1}, 1.0F / 4096),
                                                 stream::StreamLayout({splatbus::Appearance::Radiance, 3}, 1.0F)};
  if (size < 3) return 0;
  const stream::StreamLayout& layout = layouts[data[0] >> 1U & 3U];
  const auto codec = static_cast<stream::PageCodec>(data[0] & 1U);
  const std::size_t count = data[1] + std::size_t{data[2]} * 256U;
  try {
    const stream::QuantizedGaussians page = stream::decode_page({data + 3, size - 3}, layout, codec, count);
    if (page.count() != count || count > stream::kMaxPageGaussians) std::abort();
    for (const stream::AttributeChannels& a : layout.attributes()) {
      for (int c = 0; c < a.channels; ++c) {
        for (const std::int32_t value : page.channels[static_cast<std::size_t>(a.first + c)]) {
          if (value < a.minimum || value > a.maximum) std::abort();
        }
      }
    }
  } catch (const stream::StreamError&) {  // refused
  }
  return 0;
}

#pragma once

#include "stream/page_codec.h"

// The codecs behind page_codec.h. Pages are not empty.
namespace splatbus::stream {

[[nodiscard]] PageBlob encode_draco(const QuantizedGaussians& page, const StreamLayout& layout,
                                    const PageOptions& options);
[[nodiscard]] QuantizedGaussians decode_draco(std::span<const std::uint8_t> bytes, const StreamLayout& layout,
                                              std::size_t count);

/// What of a blob is of which attribute, about; the rest is its beginning.
struct PartBytes {
  const char* name;
  double bytes;
};
[[nodiscard]] PageBlob encode_planes(const QuantizedGaussians& page, const StreamLayout& layout,
                                     const PageOptions& options, std::vector<PartBytes>* account = nullptr);
[[nodiscard]] QuantizedGaussians decode_planes(std::span<const std::uint8_t> bytes, const StreamLayout& layout,
                                               std::size_t count);

}  // namespace splatbus::stream

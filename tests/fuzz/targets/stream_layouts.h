#pragma once

#include "stream/quantized.h"
#include "target.h"

namespace splatbus::fuzz {

/// One of four.
inline const stream::StreamLayout& layout(unsigned choice) {
  static const stream::StreamLayout layouts[] = {stream::StreamLayout({Appearance::Transfer, 3}, 1.0F / 1024),
                                                 stream::StreamLayout({Appearance::Radiance, 0}, 1.0F / 1024),
                                                 stream::StreamLayout({Appearance::Radiance, 1}, 1.0F / 4096),
                                                 stream::StreamLayout({Appearance::Radiance, 3}, 1.0F)};
  return layouts[choice % 4];
}

inline void require_within_limits(const stream::QuantizedGaussians& gaussians, const stream::StreamLayout& layout) {
  for (const stream::AttributeChannels& a : layout.attributes()) {
    for (int c = 0; c < a.channels; ++c) {
      for (const std::int32_t value : gaussians.channels[static_cast<std::size_t>(a.first + c)]) {
        require(value >= a.minimum && value <= a.maximum, "every value within its limits");
      }
    }
  }
}

}  // namespace splatbus::fuzz

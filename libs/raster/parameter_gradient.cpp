#include <algorithm>

#include "raster/cpu/workers.h"
#include "raster/rasterizer.h"

namespace splatbus::raster {

void ParameterGradient::clear(const GaussiansView& gaussians, int threads) {
  std::vector<float> kept = std::move(values);
  clear_statistics(gaussians);
  values = std::move(kept);
  const int channels = layout.channels();
  values.resize(static_cast<std::size_t>(channels) * stride);
  const int active = active_channels > 0 ? std::min(active_channels, channels) : channels;
  cpu::Workers(threads).for_pieces(static_cast<std::size_t>(active), 1, [&](std::size_t plane, std::size_t) {
    std::fill_n(values.data() + plane * stride, count, 0.0F);
  });
}

void ParameterGradient::clear_statistics(const GaussiansView& gaussians) {
  const bool as_before = layout == gaussians.layout && count == gaussians.count && touched.size() == count;
  layout = gaussians.layout;
  count = gaussians.count;
  stride = gaussians.has_pages() ? gaussians.count : gaussians.stride;
  values.clear();
  if (as_before) {
    for (const IndexRange& range : written) {
      std::fill_n(touched.begin() + range.first, range.count, std::uint8_t{0});
      std::fill_n(mean2d_norm.begin() + range.first, range.count, 0.0F);
      std::fill_n(contribution.begin() + range.first, range.count, 0.0F);
    }
  } else {
    touched.assign(count, 0);
    mean2d_norm.assign(count, 0.0F);
    contribution.assign(count, 0.0F);
  }
  written.clear();
}

}  // namespace splatbus::raster

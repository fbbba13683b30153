#include <tbb/parallel_for.h>

#include <algorithm>

#include "raster/rasterizer.h"

namespace splatbus::raster {

void ParameterGradient::clear(const GaussiansView& gaussians) {
  clear_statistics(gaussians);
  const auto planes = static_cast<std::size_t>(layout.channels());
  values.resize(planes * stride);
  tbb::parallel_for(std::size_t{0}, planes, [&](std::size_t plane) {
    std::fill_n(values.begin() + static_cast<std::ptrdiff_t>(plane * stride), stride, 0.0F);
  });
}

void ParameterGradient::clear_statistics(const GaussiansView& gaussians) {
  layout = gaussians.layout;
  count = gaussians.count;
  stride = gaussians.stride;
  values.clear();
  touched.assign(count, 0);
  mean2d_norm.assign(count, 0.0F);
  contribution.assign(count, 0.0F);
}

}  // namespace splatbus::raster

#include "raster/rasterizer.h"

namespace splatbus::raster {

void ParameterGradient::clear(const GaussiansView& gaussians) {
  layout = gaussians.layout;
  count = gaussians.count;
  stride = gaussians.stride;
  values.assign(static_cast<std::size_t>(layout.channels()) * stride, 0.0F);
  touched.assign(count, 0);
  mean2d_norm.assign(count, 0.0F);
  contribution.assign(count, 0.0F);
}

}  // namespace splatbus::raster

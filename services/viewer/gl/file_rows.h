#pragma once

#include "gaussians/model.h"
#include "viewer/gl/batch.h"

namespace splatbus::viewer::gl {

/// All Gaussians of a model without pages, as row by row. Radiance, in the world's frame; without bounds.
[[nodiscard]] SharedBatch rows_of(const GaussiansView& gaussians);

}  // namespace splatbus::viewer::gl

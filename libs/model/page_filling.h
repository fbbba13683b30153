#pragma once

#include <cstddef>

#include "gaussians/model.h"
#include "model/page_store.h"

namespace splatbus::model {

/// Puts Gaussians into a store as they are, in frozen pages along a Morton curve, for a model that nobody trains. Reads
/// `gaussians`, which lies in host memory, has no pages and is of the store's layout; those that are not finite are
/// left out, and what the store has no room for. Returns how many came in.
std::size_t fill_frozen(PageStore& store, const GaussiansView& gaussians);

}  // namespace splatbus::model

#pragma once

#include <vector>

#include "bus/parameters.h"
#include "expander/batch_ledger.h"
#include "expander/grid.h"
#include "expander/insert_batch.h"
#include "expander/mapper.h"
#include "expander/visibility.h"

namespace splatbus::expander {

[[nodiscard]] std::vector<bus::ParameterSpec> parameter_specs();

/// The parameters as the parts take them.
[[nodiscard]] GridOptions grid_options(const bus::Parameters& parameters);
[[nodiscard]] VisibilityOptions visibility_options(const bus::Parameters& parameters);
[[nodiscard]] InitialOptions initial_options(const bus::Parameters& parameters);
[[nodiscard]] MapperOptions mapper_options(const bus::Parameters& parameters);
/// The most device memory that the mapper may hold.
[[nodiscard]] std::size_t device_bytes(const bus::Parameters& parameters);
[[nodiscard]] BatchLedger::Options ledger_options(const bus::Parameters& parameters);

}  // namespace splatbus::expander

#pragma once

#include <cstddef>
#include <cstdint>

#include "bus/parameters.h"
#include "expander/batch_ledger.h"
#include "expander/mapper.h"
#include "wire/model_limits.h"

namespace splatbus::expander {

/// The expander's parameters.
struct Options {
  MapperOptions mapper;
  GrowOptions grow;  ///< without viewer and room
  BatchLedger::Options ledger;
  std::size_t max_gaussians = kDefaultMaxGaussians;
  double adopt_wait_s = 3, retry_s = 1, resend_s = 1;
  std::size_t device_bytes = 0;  ///< most memory that the mapper may hold; SIZE_MAX: all

  void bind(bus::ParameterBinder& parameters);
};

}  // namespace splatbus::expander

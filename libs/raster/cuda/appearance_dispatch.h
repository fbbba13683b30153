#pragma once

#include <type_traits>

#include "gaussians/layout.h"

namespace splatbus::raster::cuda {

/// Calls `run` with the number of SH coefficients a colour as a compile-time constant, 0 for Transfer: loops over
/// coefficients unroll, and their loads overlap.
template <class Run>
void with_coefficients(const ParameterLayout& layout, Run run) {
  if (layout.appearance == Appearance::Transfer) return run(std::integral_constant<int, 0>{});
  switch (layout.sh_degree) {
    case 0:
      return run(std::integral_constant<int, 1>{});
    case 1:
      return run(std::integral_constant<int, 4>{});
    case 2:
      return run(std::integral_constant<int, 9>{});
    default:
      return run(std::integral_constant<int, 16>{});
  }
}

}  // namespace splatbus::raster::cuda

#pragma once

#include <cstddef>
#include <cstdint>
#include <utility>

#include "stream/planes/plane_model.h"

// What is predicted of a plane's lanes: values from residuals, and back. Vectorised; the same integers on every
// machine.
namespace splatbus::stream::planes {

/// How a plane's lanes are told apart.
struct Lanes {
  const std::uint8_t* shift;    ///< [count] at most kMaxShift: values are multiples of 2^shift
  const std::uint8_t* context;  ///< [count] at most kClasses - 1: what the offset grows by
};

/// The channels of the same attribute that are before this one, where Predictor::Channel and Both look.
struct Before {
  const std::int32_t* last = nullptr;
  const std::int32_t* colour = nullptr;  ///< the first of the three that this one is among
};

/// Values in the place of residuals [count]. Sums wrap around: what does not come of an encoder comes out as anything.
void residuals_to_values(const PlaneModel& model, const Lanes& lanes, const Before& before, std::size_t count,
                         std::int32_t* plane);

/// Residuals of the lanes [begin, end) of a plane, which and those before it can be read at the lane -1, too, and have
/// a 0 there.
void values_to_residuals(const PlaneModel& model, const Lanes& lanes, const Before& before, const std::int32_t* plane,
                         std::size_t begin, std::size_t end, std::int32_t* residual);

/// Least and largest of [count], which is not 0.
[[nodiscard]] std::pair<std::int32_t, std::int32_t> range_of(const std::int32_t* plane, std::size_t count);

}  // namespace splatbus::stream::planes

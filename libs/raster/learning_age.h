#pragma once

#include "math/portable.h"

// How old a Gaussian is to its learning rates. docs/decisions/0096-age-and-recovery.md says why.
namespace splatbus::raster {

/// A view has all to teach that the nearest one so far had when a metre of it takes half as many pixels or more: a
/// quarter of the area.
inline constexpr float kDetailSlack = 4;
/// Gradients agree with one another when their mean is so large a part of their root mean square, squared. Of noise
/// that part is (1 - beta1) / (1 + beta1), 0.05.
inline constexpr float kAgreement = 0.25F;
/// What is left of the age at each step of a view whose loss has risen, where gradients agree.
inline constexpr float kRecovery = 0.5F;

/// What is nearer to a camera counts as being this near.
inline constexpr float kNearestDepth_m = 0.01F;

/// A Gaussian's steps, each counted as the share that its view had to teach: the area of a pixel in the nearest view so
/// far by that in this one.
struct LearningAge {
  float near_steps = 0;
  float detail = 0;  ///< of the nearest view: pixels a metre, squared

  SPLATBUS_PORTABLE_MEMBER void advance(float view_detail) {
    const float finest = math::larger(view_detail, detail);
    if (!(finest > 0)) {
      near_steps += 1;
      return;
    }
    near_steps = (near_steps * detail + view_detail) / finest;
    detail = finest;
  }
  /// At most `steps`, which are all that there were.
  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER float of(float steps) const {
    return math::smaller(kDetailSlack * near_steps, steps);
  }
};

}  // namespace splatbus::raster

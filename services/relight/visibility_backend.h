#pragma once

#include <memory>

#include "bus/backend.h"
#include "relight/visibility.h"

namespace splatbus::relight {

/// compute_visibility on one backend: Gaussians, depth map and result lie in that backend's memory. Not thread-safe.
class VisibilityBackend {
 public:
  virtual ~VisibilityBackend() = default;

  /// As compute_visibility; `visibility` has gaussians.count entries and is written when this returns. Throws
  /// std::runtime_error when the device fails.
  virtual void compute(const GaussiansView& gaussians, const ObjectTransforms& objects, const LightDepthMap& map,
                       const VisibilityOptions& options, float* visibility) = 0;
};

/// Asserts that the build has `backend`, as choose_backend has found.
[[nodiscard]] std::unique_ptr<VisibilityBackend> make_visibility_backend(Device backend);

}  // namespace splatbus::relight

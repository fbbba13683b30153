#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <map>
#include <utility>

#include "gaussians/camera.h"

namespace splatbus::raster {

/// Tells when the loss of a camera's pictures has risen over its own slow mean. One thread.
class LossHistory {
 public:
  /// A loss above it has risen; infinite for a camera that is not known well.
  [[nodiscard]] float limit(const Camera& camera) const {
    const auto found = means_.find({camera.role, camera.id});
    return found == means_.end() || found->second.losses < kLeastLosses ? INFINITY : kRise * found->second.mean;
  }

  void add(const Camera& camera, float loss) {
    if (!std::isfinite(loss)) return;
    if (means_.size() >= kMaxCameras) means_.clear();
    Mean& of = means_[{camera.role, camera.id}];
    of.mean += std::max(kSlowness, 1 / static_cast<float>(++of.losses)) * (loss - of.mean);
  }

 private:
  static constexpr float kRise = 1.2F, kSlowness = 0.05F;
  static constexpr std::uint64_t kLeastLosses = 8;
  static constexpr std::size_t kMaxCameras = 4096;

  struct Mean {
    float mean = 0;
    std::uint64_t losses = 0;
  };
  std::map<std::pair<CameraRole, std::uint32_t>, Mean> means_;
};

}  // namespace splatbus::raster

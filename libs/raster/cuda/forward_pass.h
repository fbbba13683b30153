#pragma once

#include <cstdint>

#include "device/buffer.h"
#include "device/stream.h"
#include "raster/cuda/device_model.h"
#include "raster/cuda/kernels.h"
#include "raster/cuda/view_tables.h"
#include "raster/rasterizer.h"

namespace splatbus::raster::cuda {

/// One picture of a model in device memory, waited for: for viewers, evaluation and checks against the reference.
/// Training uses TrainStep. Not thread-safe. Throws std::runtime_error naming the CUDA error.
class ForwardPass {
 public:
  /// Draws; `training` makes room for a backward pass. `gaussians` is read until this returns. Throws
  /// std::invalid_argument for what the CUDA rasteriser cannot draw.
  void draw(const DeviceGaussians& gaussians, const Camera& camera, const SceneState& scene,
            const RenderOptions& options, bool training);

  /// Copies what draw() has drawn to the host.
  void download(Render& out) const;

  /// The arrays of the last draw().
  [[nodiscard]] const WorkspaceView& workspace() const { return workspace_.view(); }
  [[nodiscard]] const ProjectOptions& project_options() const { return project_; }
  [[nodiscard]] cudaStream_t stream() const { return stream_.get(); }

 private:
  void copy_tables(const ViewTables& tables, const DeviceGaussians& gaussians, const WorkspaceView& w);

  device::Stream stream_;
  Workspace workspace_;
  ProjectOptions project_;
  std::uint32_t isect_capacity_ = 1U << 16U, list_capacity_ = 64;
};

}  // namespace splatbus::raster::cuda

#pragma once

#include <memory>

#include "device/device.h"
#include "raster/rasterizer.h"

namespace splatbus::raster {

/// Draws any number of pictures of one model. Not thread-safe. Throws std::runtime_error when the device fails,
/// std::invalid_argument for what cannot be drawn.
class ModelRenderer {
 public:
  virtual ~ModelRenderer() = default;

  /// The model, in host memory. A device copies it now; else it is read by every draw(), in place. Call it again when
  /// the Gaussians have changed.
  virtual void take(const GaussiansView& gaussians) = 0;

  /// The model, in the memory of the device that draws: read by every draw(), in place. Its ranges and bounds are in
  /// host memory; a device copies them now. Call it again when they have changed.
  virtual void read_in_place(const GaussiansView& gaussians) = 0;

  /// One picture, ready when this returns. Reads what Rasterizer::render reads.
  virtual void draw(const Camera& camera, const SceneState& scene, const RenderOptions& options, Render& out) = 0;
};

/// `threads` is for the CPU, 0: all cores. Asserts that the build has the device.
[[nodiscard]] std::unique_ptr<ModelRenderer> make_model_renderer(Device device, int threads = 0);

}  // namespace splatbus::raster

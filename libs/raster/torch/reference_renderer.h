#pragma once

#include "raster/rasterizer.h"
#include "raster/torch/tensor.h"

namespace splatbus::raster {

/// Planes of a render as tensors: [3, H, W], [H, W], [3, H, W], [H, W].
struct ReferenceRender {
  torch::Tensor color, alpha, albedo, depth;
};

/// The oracle of every backend: the same forward as Rasterizer in plain tensor operations, dense over Gaussians times
/// pixels, so that autograd gives the gradients. `parameters` is [channels, count] and replaces gaussians.parameters
/// (the rest of `gaussians` is read: normal, visibility, visibility_u8, object_id; null planes as in Rasterizer).
/// Computes in the type of `parameters`; float64 makes it a truth to compare with. Thresholds are treated as in
/// Rasterizer: alpha clamped to 0.999, contributions under 1/255 skipped, a pixel ended once its transmittance is under
/// 1e-4.
[[nodiscard]] ReferenceRender reference_render(const torch::Tensor& parameters, const GaussiansView& gaussians,
                                               const Camera& camera, const SceneState& scene,
                                               const RenderOptions& options);

/// The loss of loss.h by autograd-able operations: rendered [3, H, W], target [3, H, W] in display space, [0, 1].
[[nodiscard]] torch::Tensor reference_loss(const torch::Tensor& rendered, const torch::Tensor& target,
                                           float ssim_weight, bool encode_srgb);

}  // namespace splatbus::raster

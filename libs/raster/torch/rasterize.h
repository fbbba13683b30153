#pragma once

#include <vector>

#include "raster/rasterizer.h"
#include "raster/torch/tensor.h"

namespace splatbus::raster {

/// Cameras of one call.
constexpr std::size_t kMaxCameras = 16;

/// What of a model is not trained, planes as in GaussiansView. An undefined tensor stands for a plane that is not
/// there. The 32-bit planes are int32, whose bits are those of the unsigned values.
struct GaussianPlanes {
  torch::Tensor normal;      ///< [3, count] float32, unit, object's frame (Transfer)
  torch::Tensor visibility;  ///< [count] float32, in [0, 1] (Transfer); undefined: 1
  torch::Tensor object_id;   ///< [count] int32; undefined: all static
  torch::Tensor flags;       ///< [count] int32, GaussianFlags; undefined: all active
};

/// Planes of a Render, float32 on the device of the parameters, contiguous. Undefined is what was not asked for.
struct RasterizedViews {
  torch::Tensor color;   ///< [cameras, 3, height, width]
  torch::Tensor alpha;   ///< [cameras, height, width]
  torch::Tensor albedo;  ///< [cameras, 3, height, width], with options.albedo, Transfer only
  torch::Tensor depth;   ///< [cameras, height, width], with options.depth
};

/// What backward() notes of each Gaussian, [count], as in ParameterGradient: for densification, and for optimisers of
/// what was seen. It adds to what is there; an undefined tensor is not gathered.
struct GaussianStatistics {
  torch::Tensor mean2d_norm;   ///< float32, sum over views of |dL/d(projected mean)| in NDC units, not of the frozen
  torch::Tensor contribution;  ///< float32, largest blending weight in any pixel
  torch::Tensor touched;       ///< uint8, not 0: blended into a pixel
};

/// Rasterizer as an operation of LibTorch: pictures of all cameras, differentiable by `parameters`. On the CPU the CPU
/// backend draws, on a CUDA device the CUDA kernels do, in place, on the current stream and in memory of LibTorch's
/// allocator.
///
/// `parameters` is [layout.channels(), count] float32; the number of channels says which layout: 41 Transfer; 14, 23,
/// 38 or 59 Radiance of degree 0 to 3. All tensors are contiguous and on one device; what is not is refused, since a
/// copy a call would cost more than it saves. Cameras have one size; `scenes` has an entry for each, or one for all.
///
/// Frozen Gaussians are drawn and their columns of the gradient are zero. A value that is not finite hides its
/// Gaussian, as in Rasterizer; none is looked for. Gradients come from color, alpha, albedo and depth; there is no
/// second derivative. Parameters that were changed in place between the pictures and backward() are refused there, as
/// LibTorch does for its own operations.
///
/// The host waits at one place: on CUDA, for the number of intersections with tiles, while the device goes on to
/// blend. Any thread may call it, several at once too. Throws c10::Error or std::invalid_argument for arguments that do
/// not fit, naming them, and std::runtime_error naming the CUDA error.
[[nodiscard]] RasterizedViews rasterize(const torch::Tensor& parameters, const GaussianPlanes& planes,
                                        const std::vector<Camera>& cameras, const std::vector<SceneState>& scenes,
                                        const RenderOptions& options = {}, const GaussianStatistics& statistics = {});

}  // namespace splatbus::raster

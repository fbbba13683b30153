#pragma once

#include <utility>
#include <vector>

#include "raster/loss.h"
#include "raster/torch/checks.h"
#include "raster/torch/rasterize.h"
#include "raster/torch/tensor.h"

// What stands behind the operations on each kind of device. Arguments were checked by the operations.
namespace splatbus::raster {

/// The arguments of one call of rasterize() but for the parameters.
struct RasterCall {
  ParameterLayout layout;
  GaussianPlanes planes;
  std::vector<Camera> cameras;
  std::vector<SceneState> scenes;  ///< one, or one a camera
  RenderOptions options;
  GaussianStatistics statistics;

  [[nodiscard]] const SceneState& scene(std::size_t camera) const { return scenes[scenes.size() == 1 ? 0 : camera]; }
};

inline bool has_albedo(const RasterCall& call) {
  return call.options.albedo && call.layout.appearance == Appearance::Transfer;
}

/// The forward pass of one call and, with `differentiable`, the backward passes after it.
class RasterPass : public torch::CustomClassHolder {
 public:
  explicit RasterPass(RasterCall of) : call(std::move(of)) {}

  /// Draws. What it leaves in `kept` is given to backward() again; autograd drops it when it is no longer needed.
  virtual RasterizedViews forward(const torch::Tensor& parameters, bool differentiable,
                                  std::vector<torch::Tensor>& kept) = 0;
  /// The gradient of the parameters. `views` is what leads to the pictures: undefined where it is zero, else
  /// contiguous.
  virtual torch::Tensor backward(const torch::Tensor& parameters, const std::vector<torch::Tensor>& kept,
                                 const RasterizedViews& views) = 0;

  const RasterCall call;
};

[[nodiscard]] c10::intrusive_ptr<RasterPass> make_cpu_pass(RasterCall call);

struct LossAndGradient {
  torch::Tensor loss;      ///< [pictures]
  torch::Tensor gradient;  ///< of each picture's loss, like `rendered`
};

/// rendered [pictures, 3, height, width], targets [pictures, height, width, 4].
[[nodiscard]] LossAndGradient cpu_image_loss(const torch::Tensor& rendered, const torch::Tensor& targets,
                                             const LossOptions& options);

/// Adam's arguments as tensors: planes [channels, count], `rates` [channels], `steps` [count] int32,
/// `touched` [count] uint8.
struct AdamTensors {
  torch::Tensor parameters, gradient, touched, rates, first, second, steps;
  float beta1 = 0, beta2 = 0, epsilon = 0, lr_half_life_steps = 0, lr_min_factor = 0;
};

void cpu_adam_step(const AdamTensors& adam);

#ifdef SPLATBUS_TORCH_HAS_CUDA
[[nodiscard]] c10::intrusive_ptr<RasterPass> make_cuda_pass(RasterCall call);
[[nodiscard]] LossAndGradient cuda_image_loss(const torch::Tensor& rendered, const torch::Tensor& targets,
                                              const LossOptions& options);
void cuda_adam_step(const AdamTensors& adam);
#endif

/// Whether `operation` goes to the CUDA kernels. Throws where there is no backend for the device.
inline bool on_cuda(const at::Device& device, const char* operation) {
  if (device.is_cpu()) return false;
#ifdef SPLATBUS_TORCH_HAS_CUDA
  if (device.is_cuda()) return true;
#endif
  TORCH_CHECK(false, words(operation, ": this build has no backend for tensors on ", device));
  return false;
}

inline c10::intrusive_ptr<RasterPass> make_pass(RasterCall call, const at::Device& device) {
#ifdef SPLATBUS_TORCH_HAS_CUDA
  if (on_cuda(device, "rasterize")) return make_cuda_pass(std::move(call));
#else
  (void)on_cuda(device, "rasterize");
#endif
  return make_cpu_pass(std::move(call));
}

}  // namespace splatbus::raster

#include <c10/cuda/CUDAGuard.h>
#include <c10/cuda/CUDAStream.h>

#include "raster/cuda/kernels.h"
#include "raster/torch/backend.h"
#include "raster/torch/cuda/adam_planes.h"

namespace splatbus::raster {

using torch::Tensor;

LossAndGradient cuda_image_loss(const Tensor& rendered, const Tensor& targets, const LossOptions& options) {
  const c10::cuda::CUDAGuard guard(rendered.device());
  const auto type = rendered.options().requires_grad(false);
  LossAndGradient out{torch::zeros({rendered.size(0)}, type), torch::empty(rendered.sizes(), type)};
  if (rendered.numel() == 0) return out;
  const std::int64_t first = reinterpret_cast<std::intptr_t>(targets.data_ptr());
  const std::int64_t bytes = targets.size(1) * targets.size(2) * targets.size(3);
  const Tensor pointers = torch::arange(first, first + bytes * targets.size(0), bytes, type.dtype(at::kLong));
  const Tensor partials = torch::empty({3 * rendered.numel()}, type);
  cuda::WorkspaceView w;
  w.batch = static_cast<int>(rendered.size(0));
  w.height = static_cast<int>(rendered.size(2));
  w.width = static_cast<int>(rendered.size(3));
  w.loss = out.loss.data_ptr<float>();
  w.ssim_partials = partials.data_ptr<float>();
  cuda::launch_loss(rendered.data_ptr<float>(), static_cast<const std::uint8_t* const*>(pointers.data_ptr()),
                    out.gradient.data_ptr<float>(), w,
                    {.ssim_weight = options.ssim_weight, .weight = 1.0F, .encode_srgb = options.encode_srgb},
                    c10::cuda::getCurrentCUDAStream().stream());
  return out;
}

void cuda_adam_step(const AdamTensors& adam) {
  const c10::cuda::CUDAGuard guard(adam.parameters.device());
  cuda::launch_adam_planes({.parameters = adam.parameters.data_ptr<float>(),
                            .gradient = adam.gradient.data_ptr<float>(),
                            .touched = adam.touched.data_ptr<std::uint8_t>(),
                            .rates = adam.rates.data_ptr<float>(),
                            .first = adam.first.data_ptr<float>(),
                            .second = adam.second.data_ptr<float>(),
                            .steps = static_cast<std::uint32_t*>(adam.steps.data_ptr()),
                            .channels = static_cast<int>(adam.parameters.size(0)),
                            .count = adam.parameters.size(1),
                            .beta1 = adam.beta1,
                            .beta2 = adam.beta2,
                            .epsilon = adam.epsilon,
                            .lr_half_life_steps = adam.lr_half_life_steps,
                            .lr_min_factor = adam.lr_min_factor},
                           c10::cuda::getCurrentCUDAStream().stream());
}

}  // namespace splatbus::raster

#pragma once

#include "raster/loss.h"
#include "raster/torch/tensor.h"

namespace splatbus::raster {

/// The loss of loss.h as an operation of LibTorch, differentiable by `rendered`: (1 - lambda) L1 + lambda (1 - SSIM) of
/// each picture, [pictures]. Loss and gradient are worked out together, in one pass, on the device of the tensors; on
/// CUDA on the current stream, with no wait.
///
/// `rendered` is [pictures, 3, height, width] float32, `targets` [pictures, height, width, 4] uint8, RGBA in display
/// space, alpha not read; both contiguous and on one device. Throws c10::Error naming what does not fit. There is no
/// second derivative.
[[nodiscard]] torch::Tensor image_loss(const torch::Tensor& rendered, const torch::Tensor& targets,
                                       const LossOptions& options = {});

}  // namespace splatbus::raster

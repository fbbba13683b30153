#pragma once

#include <vector>

#include "raster/torch/tensor.h"

namespace splatbus::raster {

struct SparseAdamOptions {
  double beta1 = 0.9, beta2 = 0.999, epsilon = 1e-15;
  /// The rates of a Gaussian fall with its own steps t to max(lr_min_factor, h / (h + t)) of what they are; h 0: they
  /// stay.
  double lr_half_life_steps = 0, lr_min_factor = 0;
};

/// Adam (raster/adam.h) on a parameter tensor of rasterize(): one pass over gradient, moments and parameters, with one
/// learning rate a channel. A Gaussian steps when any channel of its gradient is not zero, and then in all channels;
/// the moments of others rest. It keeps its own count of steps, for the bias correction.
///
/// Memory and streams are LibTorch's; on CUDA a step runs on the current stream and waits for nothing. One thread at a
/// time. Throws c10::Error naming what does not fit.
class SparseAdam {
 public:
  /// `parameters` is [channels, count] float32, contiguous, a leaf that requires a gradient. One rate a channel.
  SparseAdam(torch::Tensor parameters, const std::vector<double>& rates, const SparseAdamOptions& options = {});

  /// Adds a step to parameters in place by parameters.grad(); nothing when it has none.
  void step();
  void zero_grad();
  void set_rates(const std::vector<double>& rates);

 private:
  torch::Tensor parameters_, rates_, first_, second_, steps_;
  SparseAdamOptions options_;
};

}  // namespace splatbus::raster

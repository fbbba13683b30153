#include "raster/torch/sparse_adam.h"

#include <utility>

#include "raster/torch/backend.h"
#include "raster/torch/checks.h"

namespace splatbus::raster {

using torch::Tensor;

SparseAdam::SparseAdam(Tensor parameters, const std::vector<double>& rates, const SparseAdamOptions& options)
    : parameters_(std::move(parameters)), options_(options) {
  TORCH_CHECK(parameters_.defined() && parameters_.dim() == 2, "SparseAdam: parameters is not [channels, count]");
  check_tensor(parameters_, "SparseAdam", "parameters", at::kFloat, parameters_.sizes(), parameters_.device());
  TORCH_CHECK(parameters_.is_leaf() && parameters_.requires_grad(),
              "SparseAdam: parameters is not a leaf that requires a gradient");
  const auto is_decay = [](double beta) { return beta >= 0 && beta < 1; };
  TORCH_CHECK(is_decay(options.beta1) && is_decay(options.beta2),
              words("SparseAdam: beta1 is ", options.beta1, " and beta2 ", options.beta2, ", not within [0, 1)"));
  TORCH_CHECK(static_cast<float>(options.epsilon) > 0,
              words("SparseAdam: epsilon is ", options.epsilon, ", not above 0"));
  (void)on_cuda(parameters_.device(), "SparseAdam");
  first_ = torch::zeros_like(parameters_.detach());
  second_ = torch::zeros_like(first_);
  steps_ = torch::zeros({parameters_.size(1)}, first_.options().dtype(at::kInt));
  set_rates(rates);
}

void SparseAdam::set_rates(const std::vector<double>& rates) {
  TORCH_CHECK(static_cast<std::int64_t>(rates.size()) == parameters_.size(0),
              words("SparseAdam: ", rates.size(), " learning rates for ", parameters_.size(0), " channels"));
  rates_ = torch::tensor(rates, at::kDouble).to(at::kFloat).to(parameters_.device());
}

void SparseAdam::zero_grad() {
  parameters_.mutable_grad() = Tensor();
}

void SparseAdam::step() {
  const Tensor gradient = parameters_.grad();
  if (!gradient.defined()) return;
  const at::NoGradGuard no_gradient;
  check_tensor(gradient, "SparseAdam", "the gradient", at::kFloat, parameters_.sizes(), parameters_.device());
  AdamTensors adam{.parameters = parameters_,
                   .gradient = gradient,
                   .touched = gradient.ne(0).any(0).to(at::kByte),
                   .rates = rates_,
                   .first = first_,
                   .second = second_,
                   .steps = steps_,
                   .beta1 = static_cast<float>(options_.beta1),
                   .beta2 = static_cast<float>(options_.beta2),
                   .epsilon = static_cast<float>(options_.epsilon),
                   .lr_half_life_steps = static_cast<float>(options_.lr_half_life_steps),
                   .lr_min_factor = static_cast<float>(options_.lr_min_factor)};
#ifdef SPLATBUS_TORCH_HAS_CUDA
  if (parameters_.is_cuda()) {
    cuda_adam_step(adam);
  } else {
    cpu_adam_step(adam);
  }
#else
  cpu_adam_step(adam);
#endif
  // Graphs that saved the values from before have to know.
  parameters_.unsafeGetTensorImpl()->bump_version();
}

}  // namespace splatbus::raster

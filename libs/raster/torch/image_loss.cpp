#include "raster/torch/image_loss.h"

#include <torch/csrc/autograd/custom_function.h>

#include "raster/torch/backend.h"
#include "raster/torch/checks.h"

namespace splatbus::raster {
namespace {

using torch::Tensor;
using torch::autograd::AutogradContext;
using torch::autograd::variable_list;

constexpr std::int64_t kMaxPictures = 1024, kMaxSide = 1 << 15, kMaxPixels = std::int64_t{1} << 30;

LossAndGradient loss_and_gradient(const Tensor& rendered, const Tensor& targets, const LossOptions& options) {
#ifdef SPLATBUS_TORCH_HAS_CUDA
  if (on_cuda(rendered.device(), "image_loss")) return cuda_image_loss(rendered, targets, options);
#else
  (void)on_cuda(rendered.device(), "image_loss");
#endif
  return cpu_image_loss(rendered, targets, options);
}

class ImageLossFunction : public torch::autograd::Function<ImageLossFunction> {
 public:
  static Tensor forward(AutogradContext* context, const Tensor& rendered, const Tensor& targets,
                        const LossOptions& options) {
    const LossAndGradient both = loss_and_gradient(rendered, targets, options);
    context->save_for_backward({both.gradient});
    return both.loss;
  }

  static variable_list backward(AutogradContext* context, const variable_list& gradients) {
    TORCH_CHECK(!at::GradMode::is_enabled(), "image_loss: there is no second derivative, which create_graph asks for");
    const Tensor of_loss = context->get_saved_variables()[0];
    return {of_loss * gradients[0].reshape({-1, 1, 1, 1}), Tensor(), Tensor()};
  }
};

}  // namespace

Tensor image_loss(const Tensor& rendered, const Tensor& targets, const LossOptions& options) {
  TORCH_CHECK(rendered.defined() && rendered.dim() == 4, "image_loss: rendered is not [pictures, 3, height, width]");
  const std::int64_t pictures = rendered.size(0), height = rendered.size(2), width = rendered.size(3);
  TORCH_CHECK(
      pictures <= kMaxPictures && height <= kMaxSide && width <= kMaxSide && pictures * height * width <= kMaxPixels,
      words("image_loss: rendered is ", rendered.sizes(), "; at most ", kMaxPictures, " pictures, sides of ", kMaxSide,
            " and 2^30 pixels are compared at once"));
  TORCH_CHECK(options.ssim_weight >= 0 && options.ssim_weight <= 1,
              words("image_loss: ssim_weight is ", options.ssim_weight, ", not within [0, 1]"));
  check_tensor(rendered, "image_loss", "rendered", at::kFloat, {pictures, 3, height, width}, rendered.device());
  check_tensor(targets, "image_loss", "targets", at::kByte, {pictures, height, width, 4}, rendered.device());
  if (!at::GradMode::is_enabled() || !rendered.requires_grad()) {
    return loss_and_gradient(rendered, targets, options).loss;
  }
  return ImageLossFunction::apply(rendered, targets, options);
}

}  // namespace splatbus::raster

// On a stream of LibTorch's, beside others.
#include <c10/cuda/CUDAGuard.h>
#include <c10/cuda/CUDAStream.h>
#include <cuda_runtime_api.h>

#include <chrono>
#include <future>

#include "raster/torch/image_loss.h"
#include "raster/torch/sparse_adam.h"
#include "tensor_scene.h"

namespace splatbus::raster {
namespace {

using testing::TensorScene;
using torch::Tensor;

/// Keeps a stream from going on.
class Barrier {
 public:
  explicit Barrier(cudaStream_t stream) {
    const auto wait = [](void* self) {
      constexpr auto kAtMost = std::chrono::seconds(20);
      auto& barrier = *static_cast<Barrier*>(self);
      barrier.open_in_time = barrier.opened_.get_future().wait_for(kAtMost) == std::future_status::ready;
    };
    EXPECT_EQ(cudaLaunchHostFunc(stream, wait, this), cudaSuccess);
  }
  void open() { opened_.set_value(); }

  bool open_in_time = false;

 private:
  std::promise<void> opened_;
};

Tensor gradient_of(const TensorScene& model, const Tensor& targets) {
  model.parameters.mutable_grad() = Tensor();
  const auto views = rasterize(model.parameters, model.planes, testing::test_cameras(2, 64, 48), {model.scene.state});
  image_loss(views.color, targets).sum().backward();
  return model.parameters.grad();
}

TEST(RasterizeStreams, OperationsRunOnTheCurrentStreamAlone) {
  if (!torch::cuda::is_available()) GTEST_SKIP() << "no CUDA device";
  const TensorScene model(testing::random_scene(testing::transfer_layout(), 200, {}, 1), at::kCUDA);
  const Tensor targets = torch::full({2, 48, 64, 4}, 100, torch::kUInt8).to(at::kCUDA);
  const Tensor expected = gradient_of(model, targets).clone();
  SparseAdam optimizer(model.parameters, std::vector<double>(41, 0.01));
  const auto everything = [&] {
    const Tensor gradient = gradient_of(model, targets).clone();
    optimizer.step();
    return gradient;
  };
  const c10::cuda::CUDAStream others = c10::cuda::getDefaultCUDAStream();
  Tensor gradient;
  {
    const c10::cuda::CUDAStreamGuard guard(c10::cuda::getStreamFromPool());
    for (int k = 0; k < 2; ++k) gradient = everything();  // what has to be allocated, is
    c10::cuda::getCurrentCUDAStream().synchronize();
    others.synchronize();
    {
      const at::NoGradGuard no_gradient;
      model.parameters.copy_(TensorScene(model.scene, at::kCUDA).parameters);
      c10::cuda::getCurrentCUDAStream().synchronize();
    }
    Barrier barrier(others.stream());
    gradient = everything();
    c10::cuda::getCurrentCUDAStream().synchronize();
    EXPECT_EQ(cudaStreamQuery(others.stream()), cudaErrorNotReady);
    barrier.open();
    others.synchronize();
    EXPECT_TRUE(barrier.open_in_time);
  }
  EXPECT_LT(testing::relative_error(gradient, expected), 1e-5);
}

}  // namespace
}  // namespace splatbus::raster

// What the operations refuse, and in which words.
#include <gmock/gmock.h>

#include "raster/torch/image_loss.h"
#include "raster/torch/rasterize.h"
#include "raster/torch/sparse_adam.h"
#include "tensor_scene.h"

namespace splatbus::raster {
namespace {

using ::testing::HasSubstr;
using testing::TensorScene;
using torch::Tensor;

template <class Call>
std::string message_of(Call call) {
  try {
    call();
  } catch (const c10::Error& error) {
    return error.what_without_backtrace();
  }
  return "nothing was thrown";
}

class RasterizeArguments : public ::testing::Test {
 protected:
  [[nodiscard]] std::string message() const {
    return message_of([&] { (void)rasterize(parameters, planes, cameras, scenes, {}, statistics); });
  }

  TensorScene model{testing::random_scene(testing::transfer_layout(), 10, {}, 1), at::kCPU};
  Tensor parameters = model.parameters;
  GaussianPlanes planes = model.planes;
  std::vector<Camera> cameras = testing::test_cameras(2, 20, 10);
  std::vector<SceneState> scenes{model.scene.state};
  GaussianStatistics statistics;
};

TEST_F(RasterizeArguments, ParametersOfAnotherKind) {
  parameters = Tensor();
  EXPECT_THAT(message(), HasSubstr("parameters is not [channels, count]"));
  parameters = torch::zeros({41});
  EXPECT_THAT(message(), HasSubstr("parameters is not [channels, count]"));
  parameters = torch::zeros({40, 10});
  EXPECT_THAT(message(), HasSubstr("40 channels; a Transfer model has 41"));
  parameters = torch::zeros({41, 10}, torch::kFloat64);
  EXPECT_THAT(message(), HasSubstr("parameters is Double, Float is needed"));
  parameters = torch::zeros({10, 41}).t();
  EXPECT_THAT(message(), HasSubstr("parameters is not contiguous"));
  parameters = torch::zeros({41, 1}).expand({41, std::int64_t{1} << 25});
  EXPECT_THAT(message(), HasSubstr("33554432 Gaussians; at most 16777215"));
  parameters = torch::zeros({41, 10}, torch::kMeta);
  EXPECT_THAT(message(), HasSubstr("meta"));
}

TEST_F(RasterizeArguments, PlanesThatDoNotFit) {
  planes.normal = torch::zeros({3, 9});
  EXPECT_THAT(message(), HasSubstr("normal is [3, 9], [3, 10] is needed"));
  planes.normal = torch::zeros({3, 10}).requires_grad_(true);
  EXPECT_THAT(message(), HasSubstr("normal requires a gradient"));
  planes = {};
  planes.object_id = torch::zeros({10}, torch::kInt64);
  EXPECT_THAT(message(), HasSubstr("object_id is Long, Int is needed"));
  planes = {};
  planes.visibility = torch::zeros({20}).slice(0, 0, 20, 2);
  EXPECT_THAT(message(), HasSubstr("visibility is not contiguous"));
  planes = {};
  planes.flags = torch::zeros({10}, torch::TensorOptions(torch::kInt32).device(torch::kMeta));
  EXPECT_THAT(message(), HasSubstr("flags is on meta, the others are on cpu"));
}

TEST_F(RasterizeArguments, StatisticsThatDoNotFit) {
  statistics.touched = torch::zeros({10}, torch::kBool);
  EXPECT_THAT(message(), HasSubstr("touched is Bool, Byte is needed"));
  statistics = {};
  statistics.mean2d_norm = torch::zeros({11});
  EXPECT_THAT(message(), HasSubstr("mean2d_norm is [11], [10] is needed"));
}

TEST_F(RasterizeArguments, CamerasThatDoNotFit) {
  scenes.resize(3);
  EXPECT_THAT(message(), HasSubstr("3 scenes for 2 cameras"));
  scenes.resize(1);
  cameras[1].width = 21;
  EXPECT_THAT(message(), HasSubstr("camera 1 has 21 x 10 pixels, camera 0 20 x 10"));
  cameras[1] = cameras[0];
  cameras[1].fy = std::nanf("");
  EXPECT_THAT(message(), HasSubstr("camera 1 has focal lengths"));
  cameras[1] = cameras[0];
  cameras[1].role = CameraRole::Light;
  EXPECT_THAT(message(), HasSubstr("camera 1 is a light's"));
  cameras[1] = cameras[0];
  cameras[0].height = 0;
  EXPECT_THAT(message(), HasSubstr("camera 0 has 20 x 0 pixels"));
  cameras.assign(17, cameras[1]);
  EXPECT_THAT(message(), HasSubstr("17 cameras; a call takes 1 to 16"));
  cameras.assign(2, cameras[1]);
  for (Camera& camera : cameras) camera.width = camera.height = 1U << 15U;
  EXPECT_THAT(message(), HasSubstr("more than 2^30 pixels"));
  cameras.clear();
  EXPECT_THAT(message(), HasSubstr("0 cameras"));
}

TEST_F(RasterizeArguments, ChangedBetweenPicturesAndBackward) {
  const RasterizedViews views = rasterize(parameters, planes, cameras, scenes);
  {
    const at::NoGradGuard no_gradient;
    parameters.add_(0.1);
  }
  EXPECT_THAT(message_of([&] { views.color.sum().backward(); }), HasSubstr("modified by an inplace operation"));
}

TEST_F(RasterizeArguments, ThereIsNoSecondDerivative) {
  const RasterizedViews views = rasterize(parameters, planes, cameras, scenes);
  EXPECT_THAT(message_of([&] { views.color.sum().backward({}, /*retain_graph=*/true, /*create_graph=*/true); }),
              HasSubstr("no second derivative"));
}

TEST(ImageLossArguments, AreNamed) {
  const Tensor rendered = torch::zeros({2, 3, 8, 6}), targets = torch::zeros({2, 8, 6, 4}, torch::kUInt8);
  const auto message = [](const Tensor& a, const Tensor& b, const LossOptions& options = {}) {
    return message_of([&] { (void)image_loss(a, b, options); });
  };
  EXPECT_THAT(message(rendered[0], targets), HasSubstr("rendered is not [pictures, 3, height, width]"));
  EXPECT_THAT(message(rendered.slice(1, 0, 2), targets), HasSubstr("rendered is [2, 2, 8, 6]"));
  EXPECT_THAT(message(rendered.to(torch::kHalf), targets), HasSubstr("rendered is Half"));
  EXPECT_THAT(message(rendered, targets.slice(3, 0, 3)), HasSubstr("targets is [2, 8, 6, 3], [2, 8, 6, 4] is needed"));
  EXPECT_THAT(message(rendered, targets.to(torch::kFloat32)), HasSubstr("targets is Float, Byte is needed"));
  EXPECT_THAT(message(rendered, targets, {.ssim_weight = 2}), HasSubstr("ssim_weight is 2"));
}

TEST(SparseAdamArguments, AreNamed) {
  const Tensor leaf = torch::zeros({14, 5}).requires_grad_(true);
  const std::vector<double> rates(14, 0.01);
  EXPECT_THAT(message_of([&] { SparseAdam(torch::zeros({14, 5}), rates); }), HasSubstr("requires a gradient"));
  EXPECT_THAT(message_of([&] { SparseAdam(leaf * 2, rates); }), HasSubstr("not a leaf"));
  EXPECT_THAT(message_of([&] { SparseAdam(leaf, {0.01}); }), HasSubstr("1 learning rates for 14 channels"));
  EXPECT_THAT(message_of([&] { SparseAdam(leaf, rates, {.beta1 = 1}); }), HasSubstr("beta1 is 1 and beta2 0.999"));
  EXPECT_THAT(message_of([&] { SparseAdam(leaf, rates, {.epsilon = 0}); }), HasSubstr("epsilon is 0, not above 0"));
}

}  // namespace
}  // namespace splatbus::raster

// The CUDA backend against the CPU one, whose gradients are checked against autograd: same pictures, same gradients.
#include "cuda_scenes.h"
#include "raster/cuda/cuda_rasterizer.h"

namespace splatbus::raster::testing {
namespace {

/// ||a - b|| / ||b|| over channels [first, last) of Gaussians' gradients.
double relative_error(const ParameterGradient& a, const ParameterGradient& b, int first, int last) {
  double difference = 0, norm = 0;
  for (int c = first; c < last; ++c) {
    for (std::size_t i = 0; i < a.count; ++i) {
      const std::size_t at = static_cast<std::size_t>(c) * a.stride + i;
      difference += std::pow(a.values[at] - b.values[at], 2);
      norm += std::pow(b.values[at], 2);
    }
  }
  return std::sqrt(difference / std::max(norm, 1e-30));
}

class CudaParity : public CudaTest, public ::testing::WithParamInterface<Case> {};

TEST_P(CudaParity, PicturesAndGradientsMatchTheCpuBackend) {
  const Case& c = GetParam();
  const GaussiansBuffer model = random_model(c, 11);
  const SceneState scene = random_scene(c.objects);
  const Camera camera = look_at({0.5F, 1.5F, 5.0F}, {0, 0, 0}, c.width, c.height, 1.0F);
  const bool transfer = c.layout.appearance == Appearance::Transfer;
  const RenderOptions options{.antialias = c.antialias, .albedo = transfer};
  const auto cpu = make_cpu_rasterizer(2);
  const auto gpu = make_cuda_rasterizer();
  Render expected, actual;
  cpu->forward(model.view(), camera, scene, options, expected);
  gpu->forward(model.view(), camera, scene, options, actual);
  EXPECT_LT(largest_difference(actual.color, expected.color), 1e-3);
  EXPECT_LT(largest_difference(actual.alpha, expected.alpha), 1e-3);
  if (transfer) {
    EXPECT_LT(largest_difference(actual.albedo, expected.albedo), 1e-3);
  }

  std::mt19937 random(5);
  std::normal_distribution<float> normal;
  RenderGradient gradient;
  gradient.color = Image(c.width, c.height, 3);
  for (float& value : gradient.color.data) value = normal(random);
  if (transfer) {
    gradient.albedo = Image(c.width, c.height, 3);
    for (float& value : gradient.albedo.data) value = normal(random);
  }
  ParameterGradient expected_gradient, actual_gradient;
  expected_gradient.clear(model.view());
  actual_gradient.clear(model.view());
  cpu->backward(gradient, expected_gradient);
  gpu->backward(gradient, actual_gradient);
  // A pixel on the edge of 1/255 may fall either way.
  std::size_t differing = 0;
  for (std::size_t i = 0; i < model.count(); ++i) {
    differing += (actual_gradient.touched[i] != 0) != (expected_gradient.touched[i] != 0) ? 1 : 0;
  }
  EXPECT_LE(differing, model.count() / 200) << "touched";
  const int appearance_end = c.layout.channels();
  EXPECT_LT(relative_error(actual_gradient, expected_gradient, 0, 3), 1e-3) << "mean";
  EXPECT_LT(relative_error(actual_gradient, expected_gradient, 3, 6), 1e-3) << "log scale";
  EXPECT_LT(relative_error(actual_gradient, expected_gradient, 6, 10), 1e-3) << "rotation";
  EXPECT_LT(relative_error(actual_gradient, expected_gradient, 10, 11), 1e-3) << "opacity";
  EXPECT_LT(relative_error(actual_gradient, expected_gradient, 11, 14), 1e-3) << "albedo or DC";
  if (appearance_end > 14) {
    EXPECT_LT(relative_error(actual_gradient, expected_gradient, 14, appearance_end), 1e-3) << "rest";
  }
}

INSTANTIATE_TEST_SUITE_P(
    Cases, CudaParity,
    ::testing::Values(Case{"Transfer", {Appearance::Transfer, 0}, 400, 96, 64, true, true, -2.0F},
                      Case{"TransferClassic", {Appearance::Transfer, 0}, 400, 70, 50, false, false, -2.0F},
                      Case{"TransferSmall", {Appearance::Transfer, 0}, 3000, 128, 128, true, true, -4.0F},
                      Case{"Radiance0", {Appearance::Radiance, 0}, 500, 64, 64, true, false, -2.0F},
                      Case{"Radiance3", {Appearance::Radiance, 3}, 500, 100, 80, true, true, -2.5F},
                      // Occluded by their neighbours, mostly.
                      Case{"Dense", {Appearance::Radiance, 0}, 6000, 64, 64, true, false, -2.0F},
                      Case{"Huge", {Appearance::Radiance, 1}, 60, 64, 64, true, false, 0.5F}),
    case_name);

TEST_F(CudaTest, NormalsAndVisibilityMayBeMissing) {
  const Case c{"", {Appearance::Transfer, 0}, 300, 48, 40, true, true, -2.0F};
  const GaussiansBuffer model = random_model(c, 23);
  const SceneState scene = random_scene(true);
  const Camera camera = look_at({0.5F, 1.5F, 5.0F}, {0, 0, 0}, c.width, c.height, 1.0F);
  GaussiansView view = model.view();
  view.normal = nullptr;
  view.visibility = nullptr;
  Render expected, actual;
  make_cpu_rasterizer(1)->render(view, camera, scene, {}, expected);
  make_cuda_rasterizer()->render(view, camera, scene, {}, actual);
  EXPECT_LT(largest_difference(actual.color, expected.color), 1e-3);
}

}  // namespace
}  // namespace splatbus::raster::testing

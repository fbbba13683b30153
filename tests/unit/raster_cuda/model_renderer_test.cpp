// Pictures of a model that lies in host memory, or on the device, against the CPU's.
#include "raster/model_renderer.h"

#include "../raster/lights.h"
#include "cuda_scenes.h"
#include "raster/cuda/device_model.h"

namespace splatbus::raster::testing {
namespace {

class ModelRendererOnDevice : public CudaTest {
 protected:
  static constexpr Case kTransfer{"Transfer", {}, 3000, 200, 120, true, true, -2.5F};
  static constexpr Case kRadiance{"Radiance", {Appearance::Radiance, 2}, 2000, 120, 200, true, true, -2.5F};

  static Camera camera_of(const Case& c) { return look_at({0.5F, 1.5F, 5.0F}, {0, 0, 0}, c.width, c.height, 1.0F); }
  static void expect_cpu_picture(const GaussiansBuffer& model, const Case& c, const Render& actual,
                                 double tolerance = 1e-3) {
    Render expected;
    make_cpu_rasterizer(2)->render(model.view(), camera_of(c), random_scene(c.objects), {}, expected);
    ASSERT_EQ(actual.color.data.size(), expected.color.data.size());
    EXPECT_LT(largest_difference(actual.color, expected.color), tolerance);
    EXPECT_LT(largest_difference(actual.alpha, expected.alpha), tolerance);
    double sum = 0;
    for (std::size_t k = 0; k < actual.color.data.size(); ++k) {
      sum += std::abs(actual.color.data[k] - expected.color.data[k]);
    }
    EXPECT_LT(sum / static_cast<double>(actual.color.data.size()), 1e-5);
  }
};

TEST_F(ModelRendererOnDevice, TakesModelsOfAnySizeInTurn) {
  const auto renderer = make_model_renderer(Device::Cuda);
  Render picture;
  for (const Case& c : {kRadiance, kTransfer, kRadiance}) {
    GaussiansBuffer model = random_model(c, 5);
    const GaussiansBuffer same = model;
    renderer->take(model.view());
    for (float& value : model.parameters) value = 0;  // it was copied
    renderer->draw(camera_of(c), random_scene(c.objects), {}, picture);
    expect_cpu_picture(same, c, picture);
  }
}

TEST_F(ModelRendererOnDevice, ReadsThePlanesInPlace) {
  const auto renderer = make_model_renderer(Device::Cuda);
  GaussiansBuffer model = random_model(kTransfer, 6);
  cuda::DeviceModel planes;
  const auto draw = [&] {
    planes.upload(model.view(), nullptr);
    ASSERT_EQ(cudaDeviceSynchronize(), cudaSuccess);
    const cuda::DeviceGaussians& device = planes.view();
    GaussiansView view = model.view();
    view.stride = static_cast<std::size_t>(device.stride);
    view.parameters = device.parameters;
    view.normal = device.normal;
    view.visibility = device.visibility;
    view.object_id = device.object_id;
    view.flags = device.flags;
    renderer->read_in_place(view);
    Render picture;
    renderer->draw(camera_of(kTransfer), random_scene(true), {}, picture);
    expect_cpu_picture(model, kTransfer, picture);
  };
  draw();
  for (std::size_t i = 0; i < model.count(); ++i) model.parameters[i] += 0.2F;
  draw();
}

TEST_F(ModelRendererOnDevice, BringsTheRowsOfVisibility) {
  const auto renderer = make_model_renderer(Device::Cuda);
  GaussiansBuffer model = random_model(kTransfer, 8);
  const GaussiansBuffer same = model;
  SceneState scene = random_scene(true);
  add_sources(scene.light);
  const std::size_t stride = model.count() + 9;
  std::vector<std::uint8_t> rows = random_bytes(5 * stride, 4);
  const std::vector<std::uint8_t> same_rows = rows;
  const auto with_rows = [&](const GaussiansBuffer& of, const std::vector<std::uint8_t>& values) {
    GaussiansView view = of.view();
    view.visibility_u8 = values.data();
    view.visibility_stride = stride;
    view.visibility_rows = 5;
    return view;
  };
  renderer->take(with_rows(model, rows));
  rows.assign(rows.size(), 0);  // they were copied
  Render picture, expected;
  renderer->draw(camera_of(kTransfer), scene, {}, picture);
  make_cpu_rasterizer(2)->render(with_rows(same, same_rows), camera_of(kTransfer), scene, {}, expected);
  EXPECT_LT(largest_difference(picture.color, expected.color), 1e-3);
}

TEST_F(ModelRendererOnDevice, DrawsNothingAndRefusesWhatItCannot) {
  const auto renderer = make_model_renderer(Device::Cuda);
  const GaussiansBuffer none;
  Render picture;
  const SceneState scene = random_scene(false);
  renderer->take(none.view());
  renderer->draw(camera_of(kTransfer), scene, {}, picture);
  ASSERT_EQ(picture.color.width, kTransfer.width);
  EXPECT_EQ(picture.color.plane(2)[0], scene.light.background.z);
  Camera light = camera_of(kTransfer);
  light.role = CameraRole::Light;
  EXPECT_THROW(renderer->draw(light, scene, {}, picture), std::invalid_argument);
}

TEST_F(ModelRendererOnDevice, DrawsWhatWantsMoreListsThanBefore) {
  const Case c{"Large", {}, 20'000, 256, 256, true, true, -3.0F};
  const GaussiansBuffer model = random_model(c, 7);
  const auto renderer = make_model_renderer(Device::Cuda);
  Render picture;
  renderer->take(model.view());
  renderer->draw(camera_of(c), random_scene(true), {}, picture);
  // Among so many there is a contribution that rounding takes across the least one that counts, 1/255.
  expect_cpu_picture(model, c, picture, 1.5 / 255);
}

}  // namespace
}  // namespace splatbus::raster::testing

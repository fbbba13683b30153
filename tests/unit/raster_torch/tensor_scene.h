#pragma once

#include <gtest/gtest.h>
#include <torch/cuda.h>

#include <string>
#include <vector>

#include "raster/torch/rasterize.h"
#include "raster/torch/reference_renderer.h"
#include "scenes.h"

namespace splatbus::raster::testing {

/// A TestScene as contiguous tensors on a device; `scene` stays for the reference renderer.
struct TensorScene {
  TestScene scene;
  torch::Tensor parameters;
  GaussianPlanes planes;

  TensorScene(TestScene of, const at::Device& device) : scene(std::move(of)) {
    const auto floats = [&](std::vector<float>& plane, std::int64_t rows) {
      return rows_of(plane.data(), rows, torch::kFloat32).to(device);
    };
    const auto words = [&](std::vector<std::uint32_t>& plane) {
      return rows_of(plane.data(), 1, torch::kInt32).reshape({-1}).to(device);
    };
    parameters = floats(scene.parameters, scene.layout.channels()).requires_grad_(true);
    planes = {floats(scene.normal, 3), floats(scene.visibility, 1).reshape({-1}), words(scene.object_id),
              words(scene.flags)};
  }

  /// float64 on the host, for the reference renderer.
  [[nodiscard]] torch::Tensor truth() const {
    return parameters.detach().to(torch::kCPU, torch::kFloat64).clone().requires_grad_(true);
  }

 private:
  torch::Tensor rows_of(void* data, std::int64_t rows, at::ScalarType type) const {
    return torch::from_blob(data, {rows, static_cast<std::int64_t>(scene.stride)}, type)
        .slice(1, 0, static_cast<std::int64_t>(scene.count))
        .clone(at::MemoryFormat::Contiguous);
  }
};

inline std::vector<Camera> test_cameras(std::size_t count, std::uint32_t width, std::uint32_t height) {
  std::vector<Camera> cameras;
  for (std::size_t k = 0; k < count; ++k) {
    Camera camera = test_camera(width, height);
    const float turn = 0.5F * static_cast<float>(k);
    const Rigid world_from_world{glm::angleAxis(turn, glm::vec3(0, 1, 0)), {0, 0, 0}};
    camera.world_from_camera = world_from_world * camera.world_from_camera;
    camera.fx *= 1 + 0.1F * turn;
    cameras.push_back(camera);
  }
  return cameras;
}

/// The reference renderer's pictures of all cameras, in the shape of rasterize().
inline RasterizedViews reference_views(const torch::Tensor& parameters, const TestScene& scene,
                                       const std::vector<Camera>& cameras, const std::vector<SceneState>& scenes,
                                       const RenderOptions& options) {
  std::vector<torch::Tensor> color, alpha, albedo, depth;
  for (std::size_t k = 0; k < cameras.size(); ++k) {
    const ReferenceRender one =
        reference_render(parameters, scene.view(), cameras[k], scenes[scenes.size() == 1 ? 0 : k], options);
    color.push_back(one.color);
    alpha.push_back(one.alpha);
    if (one.albedo.defined()) albedo.push_back(one.albedo);
    if (one.depth.defined()) depth.push_back(one.depth);
  }
  const auto stacked = [](const std::vector<torch::Tensor>& planes) {
    return planes.empty() ? torch::Tensor() : torch::stack(planes);
  };
  return {stacked(color), stacked(alpha), stacked(albedo), stacked(depth)};
}

inline torch::Tensor as_truth(const torch::Tensor& tensor) {
  return tensor.detach().to(torch::kCPU, torch::kFloat64);
}
inline double relative_error(const torch::Tensor& ours, const torch::Tensor& truth) {
  const torch::Tensor expected = as_truth(truth);
  return ((as_truth(ours) - expected).norm() / expected.norm().clamp_min(1e-12)).item<double>();
}
inline double largest_difference(const torch::Tensor& ours, const torch::Tensor& truth) {
  return (as_truth(ours) - as_truth(truth)).abs().max().item<double>();
}

/// Each test runs on every device that LibTorch has.
class OnDevice : public ::testing::TestWithParam<const char*> {
 protected:
  void SetUp() override {
    if (at::Device(GetParam()).is_cuda() && !torch::cuda::is_available()) GTEST_SKIP() << "no CUDA device";
  }
  [[nodiscard]] static at::Device device() { return at::Device(GetParam()); }
};

inline std::string device_name(const ::testing::TestParamInfo<const char*>& info) {
  return info.param;
}

}  // namespace splatbus::raster::testing

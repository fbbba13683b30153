#include <fstream>
#include <sstream>

#include "tensor_scene.h"
// The example of docs/torch.md is what lies between the lines of dashes.
// ----
#include "raster/torch/image_loss.h"
#include "raster/torch/rasterize.h"
#include "raster/torch/sparse_adam.h"

/// Trains parameters [channels, count] on pictures [cameras, height, width, 4], all on one device.
void train(const torch::Tensor& parameters, const splatbus::raster::GaussianPlanes& planes,
           const std::vector<splatbus::Camera>& cameras, const splatbus::SceneState& scene,
           const torch::Tensor& pictures, const std::vector<double>& rates, int steps) {
  splatbus::raster::SparseAdam optimizer(parameters, rates);
  for (int step = 0; step < steps; ++step) {
    optimizer.zero_grad();
    const auto views = splatbus::raster::rasterize(parameters, planes, cameras, {scene});
    splatbus::raster::image_loss(views.color, pictures).mean().backward();
    optimizer.step();
  }
}
// ----

namespace splatbus::raster {
namespace {

std::string read(const std::string& path) {
  std::ifstream file(path);
  std::stringstream text;
  text << file.rdbuf();
  return text.str();
}

TEST(Example, Trains) {
  const testing::TensorScene model(testing::random_scene(testing::transfer_layout(), 50, {}, 1), at::kCPU);
  const std::vector<Camera> cameras = testing::test_cameras(2, 32, 24);
  const torch::Tensor pictures = torch::full({2, 24, 32, 4}, 128, torch::kUInt8);
  const auto loss = [&] {
    const at::NoGradGuard no_gradient;
    const auto views = rasterize(model.parameters, model.planes, cameras, {model.scene.state});
    return image_loss(views.color, pictures).mean().item<double>();
  };
  const double before = loss();
  train(model.parameters, model.planes, cameras, model.scene.state, pictures, std::vector<double>(41, 0.02), 30);
  EXPECT_LT(loss(), 0.5 * before);
}

TEST(Example, IsWhatTheDocumentationShows) {
  const std::string source = read(SPLATBUS_SOURCE_DIR "/tests/unit/raster_torch/example_test.cpp");
  const std::string line = "// ----\n";
  const std::size_t begin = source.find(line) + line.size(), end = source.find(line, begin);
  ASSERT_NE(end, std::string::npos);
  const std::string example = source.substr(begin, end - begin);
  EXPECT_NE(read(SPLATBUS_SOURCE_DIR "/docs/torch.md").find("```cpp\n" + example + "```"), std::string::npos);
}

}  // namespace
}  // namespace splatbus::raster

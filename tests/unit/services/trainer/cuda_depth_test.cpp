// The loss on depth, on a model in device memory and on one in host memory.
#include <limits>

#include "cuda_optimizer_fixture.h"

namespace splatbus::trainer {
namespace {

/// A scene's views with depths that are off, as by an engine whose surfaces lie elsewhere, and without some of them.
std::vector<TrainingView> with_other_depth(const SyntheticScene& scene) {
  std::vector<TrainingView> views;
  for (const auto& view : scene.views()) {
    TrainingView other = *view;
    std::vector<float> depth(view->depth.data(), view->depth.data() + view->depth.size());
    for (float& metres : depth) metres *= 1.2F;
    depth[7] = std::numeric_limits<float>::infinity();  // no surface
    depth[9] = std::numeric_limits<float>::quiet_NaN();
    other.depth = views.empty() ? Pixels<float>() : Pixels<float>(std::move(depth));
    views.push_back(std::move(other));
  }
  return views;
}

TEST_F(CudaOptimizerTest, LossOnDepthIsTheCpus) {
  for (const char* appearance : {"transfer", "radiance"}) {
    const Settings settings = {{"appearance", appearance}, {"sh_degree", "1"}, {"depth_weight", "0.8"}, {"batch", "3"}};
    Trial cuda = trial(Device::Cuda, settings);
    Trial cpu = trial(Device::Cpu, settings);
    Trial without = trial(Device::Cuda, {{"appearance", appearance}, {"sh_degree", "1"}, {"batch", "3"}});
    for (Trial* s : {&cuda, &cpu, &without}) {
      for (const TrainingView& view : with_other_depth(scene_)) s->put(view);
    }
    const double of_cuda = cuda.train(4);
    const double of_cpu = cpu.train(4);
    EXPECT_NEAR(of_cuda, of_cpu, 2e-3 * of_cpu) << appearance;
    EXPECT_GT(of_cuda, 1.02 * without.train(1)) << appearance;
    expect_close(cuda, cpu, 5e-3);
    const HostPlanes planes = cuda.planes();
    for (std::size_t i = 0; i < planes.count(); ++i) ASSERT_TRUE(std::isfinite(planes->parameters[i]));
  }
}

TEST_F(CudaOptimizerTest, DepthWeightMayChangeWhileItTrains) {
  Trial cuda = trial(Device::Cuda);
  Trial cpu = trial(Device::Cpu);
  for (Trial* s : {&cuda, &cpu}) {
    s->train(2);
    s->set("depth_weight", "0.5");
    s->train(2);
    s->set("depth_weight", "0");
    s->train(2);
  }
  expect_close(cuda, cpu, 5e-3);
}

}  // namespace
}  // namespace splatbus::trainer

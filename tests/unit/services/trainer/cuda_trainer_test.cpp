// The trainer on the device, fed from slabs of the device and from slabs of the host.
#include <limits>

#include "trainer_fixture.h"

namespace splatbus::trainer {
namespace {

class CudaTrainer : public TrainerTest {
 protected:
  void SetUp() override {
    if (!has_device(Device::Cuda)) GTEST_SKIP() << "no CUDA device";
  }
};

class CudaTrainerFedFrom : public CudaTrainer, public testing::WithParamInterface<Device> {};

TEST_P(CudaTrainerFedFrom, TrainsAndCountsWhatPassedThroughTheHost) {
  const bool on_device = GetParam() == Device::Cuda;
  const SyntheticScene scene(100, 4, 32);
  place(Device::Cuda, GetParam());
  set("batch", "1");
  set("run_until", "8");
  start();
  insert(scene.perturbed());
  show(scene);
  ASSERT_TRUE(until([&] { return stats()->step() == 8 && stats()->paused(); }));
  ASSERT_TRUE(until([&] { return published()->step() == 8; }));
  EXPECT_EQ(stats()->host_copied_bytes() == 0, on_device) << stats()->host_copied_bytes();
  const double psnr = scene.psnr(read_model().value().average());
  set("run_until", "24");
  ASSERT_TRUE(until([&] { return stats()->step() == 24 && stats()->paused(); }));
  EXPECT_GT(scene.psnr(read_model().value().average()), psnr + 1);
  EXPECT_EQ(stats()->host_copied_bytes() == 0, on_device) << stats()->host_copied_bytes();
}

INSTANTIATE_TEST_SUITE_P(Memory, CudaTrainerFedFrom, testing::Values(Device::Cuda, Device::Cpu),
                         [](const auto& param) { return std::string(name_of(param.param)); });

TEST_F(CudaTrainer, TakesVisibilityFromTheDevice) {
  place(Device::Cuda, Device::Cuda);
  start();
  insert(sample_batch(0, 1, 40));
  std::vector<std::uint8_t> seen(kPageLanes, 51);  // by index
  const HostModel before = read_model().value();
  seen[before.index(1)] = 0;
  seen[before.index(2)] = 255;
  ASSERT_TRUE(until([&] {
    publish_visibility(seen, published()->generation());
    return std::abs(read_model()->live().visibility[0] - 0.2F) < 1e-6F;
  }));
  const HostModel model = read_model().value();
  EXPECT_EQ(model.live().visibility[1], 0.0F);
  EXPECT_EQ(model.live().visibility[2], 1.0F);
  ASSERT_TRUE(until([&] { return stats() != nullptr; }));
  EXPECT_EQ(stats()->host_copied_bytes(), 0U);
}

TEST_F(CudaTrainer, GoesOnOnTheHostAndBack) {
  const SyntheticScene scene(100, 4, 32);
  set("batch", "1");
  set("run_until", "4");
  place(Device::Cuda, Device::Cuda);
  start();
  insert(scene.perturbed());
  show(scene);
  std::uint64_t step = 4;
  for (const Device backend : {Device::Cpu, Device::Cuda, Device::Cuda}) {
    ASSERT_TRUE(until([&] { return stats()->step() == step && stats()->paused(); }));
    const auto generation = published()->generation();
    stop();
    step += 4;
    set("run_until", std::to_string(step));
    place(backend, Device::Cuda);
    start();
    ASSERT_TRUE(until([&] { return published()->generation() > generation; }));
    EXPECT_EQ(published()->count(), 100U);
    EXPECT_TRUE(holds(scene.truth().batch));
    show(scene);
  }
  ASSERT_TRUE(until([&] { return stats()->step() == step && stats()->paused(); }));
}

}  // namespace
}  // namespace splatbus::trainer

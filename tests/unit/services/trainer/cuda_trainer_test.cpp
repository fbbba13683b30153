// The trainer on the device, fed from slabs of the device and from slabs of the host.
#include <limits>

#include "cuda_model_fixture.h"
#include "trainer_fixture.h"
#include "wire/published_model.h"

namespace splatbus::trainer {
namespace {

using bus::MemoryKind;

class CudaTrainer : public TrainerTest {
 protected:
  void SetUp() override {
    if (!has_device()) GTEST_SKIP() << "no CUDA device";
  }

  std::optional<PublishedModel> open(MemoryKind memory) {
    return PublishedModel::open(newest_.at("model/published"), memory);
  }
};

class CudaTrainerFedFrom : public CudaTrainer, public testing::WithParamInterface<MemoryKind> {};

TEST_P(CudaTrainerFedFrom, TrainsAndCountsWhatPassedThroughTheHost) {
  const bool on_device = GetParam() == MemoryKind::Cuda;
  const SyntheticScene scene(100, 4, 32);
  place(bus::Backend::Cuda, GetParam());
  set("batch", "1");
  set("run_until", "8");
  start();
  insert(scene.perturbed());
  show(scene);
  ASSERT_TRUE(until([&] { return stats()->step() == 8 && stats()->paused(); }));
  ASSERT_TRUE(until([&] { return published()->step() == 8; }));
  EXPECT_EQ(stats()->host_copied_bytes() == 0, on_device) << stats()->host_copied_bytes();
  const auto in_place = open(MemoryKind::Cuda);
  ASSERT_TRUE(in_place);
  EXPECT_EQ(in_place->copied_bytes(), 0U);
  auto copied = open(MemoryKind::Host);
  ASSERT_TRUE(copied);
  const double psnr = scene.psnr(copied->average());
  set("run_until", "24");
  ASSERT_TRUE(until([&] { return stats()->step() == 24 && stats()->paused(); }));
  ASSERT_TRUE(copied->refresh());
  EXPECT_GT(scene.psnr(copied->average()), psnr + 1);
  EXPECT_EQ(stats()->host_copied_bytes() == 0, on_device) << stats()->host_copied_bytes();
}

INSTANTIATE_TEST_SUITE_P(Memory, CudaTrainerFedFrom, testing::Values(MemoryKind::Cuda, MemoryKind::Host),
                         [](const auto& param) { return std::string(name_of(param.param)); });

TEST_F(CudaTrainer, TakesVisibilityFromTheDevice) {
  place(bus::Backend::Cuda, MemoryKind::Cuda);
  start();
  insert(sample_batch(0, 1, 40));
  std::vector<float> seen(40, 0.25F);
  seen[1] = std::numeric_limits<float>::quiet_NaN();
  seen[2] = 7.0F;
  std::optional<PublishedModel> model;
  ASSERT_TRUE(until([&] {
    publish_visibility(seen, published()->generation());
    model = open(MemoryKind::Host);
    return model && model->live().visibility[0] == 0.25F;
  }));
  EXPECT_EQ(model->live().visibility[1], 0.0F);
  EXPECT_EQ(model->live().visibility[2], 1.0F);
  ASSERT_TRUE(until([&] { return stats() != nullptr; }));
  EXPECT_EQ(stats()->host_copied_bytes(), 0U);
}

TEST_F(CudaTrainer, GoesOnOnTheHostAndBack) {
  const SyntheticScene scene(100, 4, 32);
  set("batch", "1");
  set("run_until", "4");
  place(bus::Backend::Cuda, MemoryKind::Cuda);
  start();
  insert(scene.perturbed());
  show(scene);
  std::uint64_t step = 4;
  for (const bus::Backend backend : {bus::Backend::Cpu, bus::Backend::Cuda, bus::Backend::Cuda}) {
    ASSERT_TRUE(until([&] { return stats()->step() == step && stats()->paused(); }));
    const auto generation = published()->generation();
    stop();
    step += 4;
    set("run_until", std::to_string(step));
    place(backend, MemoryKind::Cuda);
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

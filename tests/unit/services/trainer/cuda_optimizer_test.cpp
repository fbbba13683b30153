// The optimizer on a model in device memory beside the one on a model in host memory.
#include <numeric>

#include "cuda_optimizer_fixture.h"

namespace splatbus::trainer {
namespace {

/// The same picture without its lower half.
TrainingView upper_half(const TrainingView& view) {
  TrainingView half = view;
  half.camera.height /= 2;
  const auto kept = [](const Pixels<std::uint8_t>& pixels) {
    return Pixels<std::uint8_t>(std::vector<std::uint8_t>(pixels.data(), pixels.data() + pixels.size() / 2));
  };
  half.color = kept(view.color);
  half.albedo = kept(view.albedo);
  half.depth = {};
  return half;
}

TEST_F(CudaOptimizerTest, StepsAsTheCpuDoes) {
  for (const char* batch : {"1", "3"}) {
    Trial cuda = trial(Device::Cuda, {{"batch", batch}});
    Trial cpu = trial(Device::Cpu, {{"batch", batch}});
    const double of_cuda = cuda.train(5);
    const double of_cpu = cpu.train(5);
    EXPECT_NEAR(of_cuda, of_cpu, 2e-3 * of_cpu) << batch;
    expect_close(cuda, cpu, 5e-3);
    EXPECT_EQ(cuda.store().step(), 5U);
    EXPECT_EQ(cuda.store().views(), cpu.store().views());
    EXPECT_GT(cuda.seconds(), 0);
    EXPECT_NEAR(cuda.store().optimizer_s(), cuda.seconds(), 1e-9);
  }
}

TEST_F(CudaOptimizerTest, FindsASceneAgainAsWellAsTheCpuDoes) {
  Trial cuda = trial(Device::Cuda);
  Trial cpu = trial(Device::Cpu);
  const double before = psnr(cuda, false);
  const double loss_cuda = (cuda.train(18), cuda.train(6));
  const double loss_cpu = (cpu.train(18), cpu.train(6));
  EXPECT_GT(psnr(cuda, false), before + 8);
  EXPECT_GT(psnr(cuda, true), psnr(cpu, true) - 0.3);
  EXPECT_LT(loss_cuda, 1.05 * loss_cpu);
}

TEST_F(CudaOptimizerTest, TrainsRadianceAndWithoutResidual) {
  const Settings radiance = {{"appearance", "radiance"}, {"sh_degree", "1"}};
  const Settings stiff = {{"residual", "false"}, {"albedo_weight", "0"}};
  for (const Settings& settings : {radiance, stiff}) {
    Trial cuda = trial(Device::Cuda, settings);
    Trial cpu = trial(Device::Cpu, settings);
    EXPECT_NEAR(cuda.train(5), cpu.train(5), 1e-3);
    expect_close(cuda, cpu, 5e-3);
  }
}

TEST_F(CudaOptimizerTest, MomentsFollowInsertsIntoLargerSlabs) {
  Trial cuda = trial(Device::Cuda, {}, 112);
  Trial cpu = trial(Device::Cpu, {}, 112);
  for (Trial* s : {&cuda, &cpu}) {
    s->train(3);
    s->insert(sample_batch(1, 2, 150, 7));
    s->train(3);
    s->insert(sample_batch(1, 3, 40, 8));
    s->train(3);
    EXPECT_EQ(s->store().count(), 290U);
  }
  EXPECT_GE(cuda.store().capacity(), 290U);
  expect_close(cuda, cpu, 1e-2);
}

TEST_F(CudaOptimizerTest, RenewsPicturesAndTrainsSeveralSizesInABatch) {
  Trial cuda = trial(Device::Cuda, {{"batch", "4"}});
  Trial cpu = trial(Device::Cpu, {{"batch", "4"}});
  const SyntheticScene other(60, 3, 32);
  for (Trial* s : {&cuda, &cpu}) {
    s->train(4);
    for (const auto& view : other.views()) s->put(*view);
    s->train(4);
  }
  expect_close(cuda, cpu, 1e-2);
  TrainingView low = upper_half(*other.views().front());
  low.camera.id = 77;
  cuda.put(low);
  EXPECT_TRUE(std::isfinite(cuda.train(6)));
}

TEST_F(CudaOptimizerTest, PrunesWhatIsTransparentHugeOrNotFinite) {
  for (const Device memory : {Device::Cuda, Device::Cpu}) {
    Trial s = trial(memory, {{"prune_interval", "5"}, {"prune_min_age", "5"}});
    const std::size_t before = s.store().count();
    const std::vector<std::uint64_t> ids = s.planes().ids();
    ASSERT_EQ(ids.size(), before);
    const std::uint64_t last = ids.back();
    s.poke(ParameterLayout::kOpacityLogit, 3, -9.0F);
    s.poke(ParameterLayout::kLogScale, 4, 3.0F);
    s.poke(20, 5, std::numeric_limits<float>::quiet_NaN());
    s.train(5);
    EXPECT_EQ(s.store().count(), before - 3);
    EXPECT_THAT(s.planes().ids(), testing::Contains(last));
    s.train(5);
    const HostPlanes planes = s.planes();
    for (std::size_t i = 0; i < planes.count(); ++i) ASSERT_TRUE(std::isfinite(planes->parameters[i]));
  }
}

TEST_F(CudaOptimizerTest, PruningComesWhileSteppingToo) {
  Trial s = trial(Device::Cuda, {{"prune_interval", "5"}, {"prune_min_age", "5"}});
  const std::size_t before = s.store().count();
  s.poke(ParameterLayout::kOpacityLogit, 3, -9.0F);
  s.poke(ParameterLayout::kOpacityLogit, 7, -9.0F);
  ViewStore views;
  for (const auto& view : scene_.views()) views.put(placed(*view, Device::Cuda));
  ViewSampler sampler(3);
  for (int i = 0; i < 12; ++i) s.optimizer().step(sampler.next_batch(views, 1, 0));
  EXPECT_EQ(s.store().count(), before - 2);
  s.optimizer().finish();
}

TEST_F(CudaOptimizerTest, TakesOtherOptionsWhileItTrains) {
  Trial s = trial(Device::Cuda);
  EXPECT_LT(s.train(6), 1.0);
  s.set("albedo_weight", "0");
  s.set("lr_mean", "0");
  const HostPlanes before = s.planes();
  s.train(2);
  EXPECT_EQ(s.planes()->parameters[0], before->parameters[0]);
}

TEST_F(CudaOptimizerTest, ChoosesABatchOfItsOwn) {
  EXPECT_EQ(trial(Device::Cuda, {{"batch", "0"}}).optimizer().options().batch, 2);
  EXPECT_EQ(trial(Device::Cpu, {{"batch", "0"}}).optimizer().options().batch, 1);
}

TEST_F(CudaOptimizerTest, AnEmptyModelOrBatchIsNoStep) {
  Trial s = trial(Device::Cuda);
  EXPECT_EQ(s.optimizer().step({}).steps, 0U);
  EXPECT_EQ(s.optimizer().finish().steps, 0U);
  EXPECT_EQ(s.store().step(), 0U);
}

}  // namespace
}  // namespace splatbus::trainer

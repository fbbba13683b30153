// The optimizer on a model in device memory beside the one on a model in host memory.
#include <limits>
#include <numeric>

#include "optimizer_fixture.h"

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

class CudaOptimizerTest : public OptimizerTest {
 protected:
  void SetUp() override {
    if (!has_device(Device::Cuda)) GTEST_SKIP() << "no CUDA device";
  }
};

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
  const double before = psnr(cuda);
  const double loss_cuda = (cuda.train(18), cuda.train(6));
  const double loss_cpu = (cpu.train(18), cpu.train(6));
  EXPECT_GT(psnr(cuda), before + 8);
  EXPECT_GT(average_psnr(cuda), average_psnr(cpu) - 0.3);
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

TEST_F(CudaOptimizerTest, MomentsFollowInsertsThatSplitPages) {
  Trial cuda = trial(Device::Cuda);
  Trial cpu = trial(Device::Cpu);
  for (Trial* s : {&cuda, &cpu}) {
    s->train(3);
    s->insert(sample_batch(1, 2, 600, 7));
    s->train(3);
    const HostModel before = s->model();
    s->insert(sample_batch(1, 3, 700, 8));
    EXPECT_GT(s->store().page_count(), 1U);
    EXPECT_NE(s->model().index(0), before.index(0)) << "the page was split";
    s->train(3);
  }
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
    auto expected = s.model().ids();
    expected.erase(expected.begin() + 3, expected.begin() + 6);
    s.poke(ParameterLayout::kOpacityLogit, 3, -9.0F);
    s.poke(ParameterLayout::kLogScale, 4, 3.0F);
    s.poke(20, 5, std::numeric_limits<float>::quiet_NaN());
    s.train(5);
    EXPECT_EQ(s.model().ids(), expected);
    s.train(5);
    const HostModel model = s.model();
    for (std::size_t k = 0; k < model.count(); ++k) ASSERT_TRUE(std::isfinite(model.at(0, k)));
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
  for (int i = 0; i < 30; ++i) s.optimizer().step(sampler.next_batch(views, 1, {}));
  EXPECT_EQ(s.store().count(), before - 2);
  s.optimizer().finish();
}

TEST_F(CudaOptimizerTest, TakesOtherOptionsWhileItTrains) {
  Trial s = trial(Device::Cuda);
  EXPECT_LT(s.train(6), 1.0);
  s.set("albedo_weight", "0");
  s.set("lr_mean", "0");
  const HostModel before = s.model();
  s.train(2);
  EXPECT_EQ(s.model().at(0, 0), before.at(0, 0));
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
    const HostModel model = cuda.model();
    for (std::size_t k = 0; k < model.count(); ++k) ASSERT_TRUE(std::isfinite(model.at(0, k)));
  }
}

TEST_F(CudaOptimizerTest, AfterAChangeLossFallsAsFastAsWithAFreshModel) {
  constexpr int kSteps = 150;
  const double fresh = loss_of_a_fresh_model(Device::Cuda, kSteps);
  EXPECT_LT(loss_after_repainting(Device::Cuda, "true", kSteps), 1.25 * fresh);
  EXPECT_GT(loss_after_repainting(Device::Cuda, "false", kSteps), 1.5 * fresh);
}

TEST_F(CudaOptimizerTest, MaskedPixelsTeachNothing) {
  masked_pixels_teach_nothing(Device::Cuda, 1e-3);
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

TEST_F(CudaOptimizerTest, AStepBeyondAllBoundsFailsAndTheNextTrainerAdoptsTheModel) {
  {
    Trial s(connect("trainer"), Device::Cuda, scene_, {});
    s.train(3);
    TrainingView giant = *scene_.views()[1];
    giant.camera.width = giant.camera.height = 40000;
    EXPECT_THROW(s.step({&giant}), std::invalid_argument);
  }
  Trial next(connect("trainer"), Device::Cuda, scene_, {});
  EXPECT_EQ(next.store().origin(), "adopted 100 Gaussians at step 3");
  next.train(2);
  EXPECT_EQ(next.store().step(), 5U);
}

TEST_F(CudaOptimizerTest, TakesVisibilityBehindTheStepsUnderWay) {
  Trial s = trial(Device::Cuda);
  std::uint64_t version = 0;
  for (const std::uint8_t value : {51, 153}) {
    s.step({scene_.views()[0].get()});
    const std::vector<std::uint8_t> seen(s.store().view().count, value);
    const std::size_t bytes = seen.size();
    const std::shared_ptr<std::byte> values = bus::allocate_memory(Device::Cuda, bytes);
    bus::copy_memory(values.get(), Device::Cuda, seen.data(), Device::Cpu, bytes);
    bus::finish_copies();
    Commands commands;
    commands.add(VisibilityCommand{.model_generation = s.store().generation(),
                                   .scene_version = ++version,
                                   .count = seen.size(),
                                   .visibility = values});
    EXPECT_FALSE(s.optimizer().apply(commands));
  }
  s.optimizer().finish();
  const HostModel model = s.model();
  for (std::size_t k = 0; k < model.count(); ++k) ASSERT_NEAR(model.live().visibility[k], 0.6F, 1e-6F);
}

TEST_F(CudaOptimizerTest, TrainsWithEachLightsOwnVisibility) {
  expect_rows_of_lights(Device::Cuda);
}

TEST_F(CudaOptimizerTest, ClonesAndSplitsWhenAsked) {
  const Settings settings = {{"densify", "true"},
                             {"densify_interval", "6"},
                             {"densify_gradient", "4e-3"},
                             {"densify_scale", "0.03"},
                             {"prune_interval", "7"}};
  Trial cuda = trial(Device::Cuda, settings);
  Trial cpu = trial(Device::Cpu, settings);
  const std::size_t before = cuda.store().count();
  cuda.train(6);
  cpu.train(6);
  // Who is near the threshold may fall either way.
  EXPECT_GT(cuda.store().count(), before + before / 10);
  EXPECT_NEAR(static_cast<double>(cuda.store().count()), static_cast<double>(cpu.store().count()), 0.05 * 100);
  cuda.train(18);
  cpu.train(18);
  EXPECT_EQ(cuda.model().count(), cuda.store().count());
  EXPECT_EQ(cuda.model().listed(), cuda.store().count());
  EXPECT_GT(psnr(cuda), psnr(cpu) - 2);
}

TEST_F(CudaOptimizerTest, DensifiesUpToTheMostThereMayBe) {
  Trial cuda = trial(Device::Cuda, {{"densify", "true"}, {"densify_interval", "2"}, {"densify_gradient", "1e-9"}});
  cuda.train(12);
  EXPECT_LE(cuda.store().count(), 4096U);
  EXPECT_GT(cuda.store().count(), 1000U);
  cuda.set("densify", "false");
  const std::size_t count = cuda.store().count();
  cuda.train(4);
  EXPECT_EQ(cuda.store().count(), count);
}

TEST_F(CudaOptimizerTest, BoundsHoldWhereTheyArePublished) {
  Trial s = trial(Device::Cuda, {{"lr_mean", "0.01"}});
  s.train(3);
  s.optimizer().publish(bus::Publisher(connect("publisher")));
  const HostModel model = s.model();
  PageBounds expected;
  for (std::size_t k = 0; k < model.count(); ++k) {
    include(expected, {model.at(0, k), model.at(1, k), model.at(2, k)},
            std::max({model.at(3, k), model.at(4, k), model.at(5, k)}));
  }
  ASSERT_EQ(s.store().view().bounds.size(), 1U);
  EXPECT_EQ(s.store().view().bounds[0].low.x, expected.low.x);
  EXPECT_EQ(s.store().view().bounds[0].high.z, expected.high.z);
  EXPECT_EQ(to_host(Device::Cuda, s.store().device_bounds(), 1)[0].low.x, expected.low.x);
}

}  // namespace
}  // namespace splatbus::trainer

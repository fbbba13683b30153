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
  Schedule schedule(3);
  for (int i = 0; i < 12; ++i) s.optimizer().step(schedule.next_batch(views, 1, 0));
  EXPECT_EQ(s.store().count(), before - 2);
  s.optimizer().finish();
}

TEST_F(CudaOptimizerTest, FrozenGaussiansStay) {
  Trial s = trial(Device::Cuda);
  s.train(2);
  Commands commands;
  commands.cells.push_back({.cells = {1}, .freeze = true});
  EXPECT_TRUE(s.optimizer().apply(commands));
  const HostPlanes before = s.planes();
  s.train(4);
  const HostPlanes after = s.planes();
  std::size_t moved = 0;
  for (std::size_t i = 0; i < after.count(); ++i) {
    if (after->cell[i] == 1) {
      EXPECT_EQ(after->parameters[i], before->parameters[i]);
      EXPECT_EQ(after->average[i], before->average[i]);
    } else {
      moved += after->parameters[i] != before->parameters[i] ? 1 : 0;
    }
  }
  EXPECT_GT(moved, before.count() / 2);
}

TEST_F(CudaOptimizerTest, KnowsHowWellCellsAreTrained) {
  const SyntheticScene scene(150, 3, 16);
  Trial cuda(connect("cuda"), Device::Cuda, scene, {});
  Trial cpu(connect("cpu"), Device::Cpu, scene, {});
  cuda.train(12);
  cpu.train(12);
  const auto early = cuda.optimizer().cells().cells();
  ASSERT_EQ(early.size(), 4U);
  for (const auto& [id, cell] : cpu.optimizer().cells().cells()) {
    EXPECT_EQ(early.at(id).count, cell.count);
    EXPECT_TRUE(early.at(id).seen);
    // Of one view, and of twelve.
    EXPECT_GT(early.at(id).loss, 0.25F * cell.loss);
    EXPECT_LT(early.at(id).loss, 4 * cell.loss);
    EXPECT_GT(early.at(id).movement, 0.0F);
  }
  // A change of structure, of nothing here, and the cells are looked at again.
  cuda.train(19);
  Commands commands;
  commands.cells.push_back({.cells = {77}, .freeze = false});
  EXPECT_TRUE(cuda.optimizer().apply(commands));
  cuda.train(1);
  float loss_before = 0;
  float loss_after = 0;
  for (const auto& [id, cell] : cuda.optimizer().cells().cells()) {
    loss_before += early.at(id).loss;
    loss_after += cell.loss;
  }
  EXPECT_LT(loss_after, 0.9F * loss_before);
}

TEST_F(CudaOptimizerTest, ObservesCellsWithThePictureThatWasDrawnLast) {
  // Every Gaussian is a cell of its own and none of them learns, so that a cell's figures are those of one pixel.
  Settings still;
  for (const char* rate : {"lr_mean", "lr_log_scale", "lr_rotation", "lr_opacity", "lr_albedo", "lr_residual"}) {
    still.emplace_back(rate, "0");
  }
  InsertBatch batch = scene_.perturbed();
  std::iota(batch.cell.begin(), batch.cell.end(), 0U);
  const TrainingView& wide = *scene_.views()[0];
  const TrainingView low = upper_half(*scene_.views()[3]);
  // Sizes are trained in ascending order on the device: the last picture drawn is the wide one, whichever comes last.
  Trial cuda(connect("cuda"), Device::Cuda, batch, still);
  Trial cpu(connect("cpu"), Device::Cpu, batch, still);
  for (int i = 0; i < 8; ++i) {
    cuda.step({&wide, &low});
    cpu.step({&low, &wide});
  }
  cuda.optimizer().finish();
  const auto& expected = cpu.optimizer().cells().cells();
  const auto& observed = cuda.optimizer().cells().cells();
  ASSERT_EQ(observed.size(), expected.size());
  std::size_t seen = 0;
  std::size_t same = 0;
  for (const auto& [id, cell] : expected) {
    const CellTable::Cell& other = observed.at(id);
    EXPECT_EQ(other.count, 1U);
    seen += cell.seen ? 1 : 0;
    same += cell.seen && other.seen && std::abs(other.loss - cell.loss) < 2e-3F && other.movement == 0 ? 1 : 0;
  }
  EXPECT_GT(seen, expected.size() / 3);
  EXPECT_GE(same + 2, seen) << "a mean beside the border of a pixel may be taken for its neighbour's";
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

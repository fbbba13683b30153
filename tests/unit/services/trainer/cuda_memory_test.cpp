// The optimizer on the device where there is no memory for what it is given.
#include "cuda_optimizer_fixture.h"

namespace splatbus::trainer {
namespace {

TEST_F(CudaOptimizerTest, LeavesOutPicturesThatThereIsNoMemoryFor) {
  Trial s = trial(Device::Cuda);
  const TrainingView& common = *scene_.views()[0];
  TrainingView giant = *scene_.views()[1];
  giant.camera.width = giant.camera.height = 40000;
  StepReport sum = s.step({&giant, &common, &giant});
  sum += s.optimizer().finish();
  EXPECT_EQ(sum.steps, 1U);
  EXPECT_EQ(sum.views, 1U);
  EXPECT_EQ(s.store().views(), 1U);
  const auto left_out = s.optimizer().take_left_out();
  ASSERT_EQ(left_out.size(), 2U);
  EXPECT_EQ(left_out[0].view->camera.width, 40000U);
  EXPECT_THAT(left_out[0].why, testing::HasSubstr("40000 x 40000"));
  EXPECT_EQ(s.step({&giant}).steps, 0U);
  EXPECT_EQ(s.store().step(), 1U);
  EXPECT_EQ(s.optimizer().take_left_out().size(), 1U);
  sum = s.step({&common});
  sum += s.optimizer().finish();
  EXPECT_EQ(sum.steps, 1U);
  EXPECT_TRUE(s.optimizer().take_left_out().empty());
}

TEST_F(CudaOptimizerTest, RefusesInsertsThatThereIsNoMemoryFor) {
  bus::Parameters parameters(bus::Parameters::declare<Options>());
  const Options options = parameters.read<Options>();
  ModelStore store(connect("trainer"), options.layout, 64, std::size_t{1} << 40, Device::Cuda);
  const auto optimizer = make_optimizer(store, options);
  InsertBatch giant = sample_batch(1, 1, 10);
  giant.count = std::size_t{1} << 33;
  Commands commands;
  commands.inserts.push_back(std::move(giant));
  EXPECT_FALSE(optimizer->apply(commands));
  EXPECT_EQ(optimizer->refused_inserts(), 1U);
  commands.inserts.push_back(sample_batch(1, 2, 20));
  EXPECT_TRUE(optimizer->apply(commands));
  EXPECT_EQ(optimizer->refused_inserts(), 2U);
  EXPECT_EQ(store.count(), 20U);
  EXPECT_FALSE(store.holds(1, 1));
  EXPECT_TRUE(store.holds(1, 2));
}

}  // namespace
}  // namespace splatbus::trainer

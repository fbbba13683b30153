// A trainer on the device that runs out of memory, and the one that comes after it; visibility from other memory.
#include "cuda_optimizer_fixture.h"

namespace splatbus::trainer {
namespace {

TEST_F(CudaOptimizerTest, AStepWithoutMemoryFailsAndTheNextTrainerAdoptsTheModel) {
  {
    Trial s(connect("trainer"), Device::Cuda, scene_, {});
    s.train(3);
    TrainingView giant = *scene_.views()[1];
    giant.camera.width = giant.camera.height = 40000;
    EXPECT_THROW(s.step({&giant}), std::runtime_error);
  }
  Trial next(connect("trainer"), Device::Cuda, scene_, {});
  EXPECT_EQ(next.store().origin(), "adopted 100 Gaussians at step 3");
  next.train(2);
  EXPECT_EQ(next.store().step(), 5U);
}

TEST_F(CudaOptimizerTest, TakesVisibilityBehindTheStepsUnderWay) {
  Trial s = trial(Device::Cuda);
  for (const float value : {0.25F, 0.75F}) {
    s.step({scene_.views()[0].get()});
    const std::vector<float> seen(s.store().count(), value);
    const std::size_t bytes = seen.size() * sizeof(float);
    const std::shared_ptr<std::byte> values = bus::allocate_memory(Device::Cuda, bytes);
    bus::copy_memory(values.get(), Device::Cuda, seen.data(), Device::Cpu, bytes);
    bus::finish_copies();
    Commands commands;
    commands.visibility = VisibilityCommand{.model_generation = s.store().structure().generation,
                                            .count = seen.size(),
                                            .memory = Device::Cuda,
                                            .visibility = values};
    EXPECT_FALSE(s.optimizer().apply(commands));
  }
  s.optimizer().finish();
  const HostPlanes planes = s.planes();
  for (std::size_t i = 0; i < planes.count(); ++i) ASSERT_EQ(planes->visibility[i], 0.75F);
}

}  // namespace
}  // namespace splatbus::trainer

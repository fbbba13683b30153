// Trainers killed with SIGKILL while their model lies in device memory, and those that come after them.
#include <algorithm>
#include <cmath>
#include <random>
#include <set>

#include "../../bus/child_process.h"
#include "cuda_model_fixture.h"
#include "cuda_peer.h"

namespace splatbus::trainer {
namespace {

using namespace std::chrono_literals;

class CudaKill : public bus_test::BusTest {
 protected:
  void SetUp() override {
    if (!has_device()) GTEST_SKIP() << "no CUDA device";
  }

  [[nodiscard]] std::string output_path() const { return directory_.path() + "/peer"; }

  /// Starts a trainer in a process of its own, and kills it some time after it is ready.
  void run_and_kill(const std::string& role, std::chrono::milliseconds life) {
    bus_test::ChildProcess trainer("test_trainer_cuda_model", {role, directory_.path()}, output_path());
    ASSERT_TRUE(bus_test::eventually(
        [&] { return bus_test::read_text(output_path()).find("ready") != std::string::npos; }, 120s))
        << bus_test::read_text(output_path());
    std::this_thread::sleep_for(life);
    trainer.send(SIGKILL);
    ASSERT_EQ(trainer.wait(), -SIGKILL) << bus_test::read_text(output_path());
  }

  std::unique_ptr<ModelStore> start(Device memory) {
    context_ = connect("trainer");
    return std::make_unique<ModelStore>(context_, ParameterLayout{}, 64, peer_max_gaussians, memory);
  }

  std::shared_ptr<bus::Context> context_;
};

void expect_sound(const ModelStore& store) {
  const HostPlanes planes(store);
  const auto ids = planes.ids();
  EXPECT_EQ(std::set<std::uint64_t>(ids.begin(), ids.end()).size(), store.count()) << "nothing is there twice";
  for (std::size_t i = 0; i < store.count(); ++i) {
    ASSERT_LT(ids[i], store.structure().next_gaussian_id);
    // Every row is that of some batch of the peer's: what belongs to a Gaussian has stayed together.
    ASSERT_EQ(planes->parameters[i], planes->surface_point[i]) << "column " << i;
    ASSERT_EQ(planes->average[i], planes->surface_point[i]) << "column " << i;
    ASSERT_EQ(planes->parameters[ParameterLayout::kOpacityLogit * planes->capacity + i], 2.0F);
    ASSERT_EQ(planes->cell[i], static_cast<std::uint64_t>(std::floor(planes->surface_point[i]) + 2.0F));
  }
}

TEST_F(CudaKill, TheModelGoesOnInEitherMemory) {
  run_and_kill("--hold", 0ms);
  std::vector<std::uint64_t> ids;
  for (const Device memory : {Device::Cuda, Device::Cpu, Device::Cpu, Device::Cuda}) {
    const auto store = start(memory);
    EXPECT_EQ(store->origin(), "adopted 2700 Gaussians at step 7");
    EXPECT_EQ(store->memory(), memory);
    EXPECT_TRUE(store->holds(1, 1));
    EXPECT_EQ(context_->adopt_slab("trainer/model-header")->descriptor().kind, Device::Cpu);
    EXPECT_EQ(broker_->statistics().slabs, 2U) << "what it was carried over from is dropped";
    expect_sound(*store);
    if (ids.empty()) ids = HostPlanes(*store).ids();
    EXPECT_EQ(HostPlanes(*store).ids(), ids);
  }
}

TEST_F(CudaKill, WhereverItIsKilledTheModelIsWhole) {
  std::mt19937 random(7);
  for (int round = 0; round < 6; ++round) {
    run_and_kill("--churn", std::chrono::milliseconds(random() % 120));
    const auto store = start(round % 3 == 2 ? Device::Cpu : Device::Cuda);
    EXPECT_GT(store->count(), peer_max_gaussians / 2) << store->origin();
    EXPECT_THAT(store->origin(), testing::HasSubstr("adopted"));
    expect_sound(*store);
  }
}

TEST_F(CudaKill, ATrainerOfTheHostIsFollowedByOneOfTheDevice) {
  auto store = start(Device::Cpu);
  store->change([&] { store->append(sample_batch(1, 1, 500)); });
  const HostPlanes before(*store);
  store.reset();
  store = start(Device::Cuda);
  EXPECT_EQ(store->count(), 500U) << store->origin();
  expect_same(before, HostPlanes(*store));
}

}  // namespace
}  // namespace splatbus::trainer

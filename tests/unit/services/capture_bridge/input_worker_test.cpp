// What the thread that samples leaves to others.
#include "capture-bridge/input_worker.h"

#include <gtest/gtest.h>

#include "../../bus/bus_fixture.h"
#include "analytic_scene.h"

namespace splatbus::capture_bridge::test {
namespace {

class InputWorkerTest : public bus_test::BusTest {
 protected:
  static InputJob job(std::uint64_t generation, bool glance = false) {
    InputJob job{.views = {}, .rig_generation = generation, .options = {.budget = 100}, .glance = glance};
    job.views.push_back(std::make_shared<const InputView>(AnalyticScene().render(small_dome(1, 8).front())));
    return job;
  }
  /// That keeps the worker busy for a second or more.
  static InputJob long_job() {
    InputJob job{.views = {}, .rig_generation = 1};
    const auto view = std::make_shared<const InputView>(AnalyticScene().render(small_dome(1, 192).front()));
    job.views.assign(40, view);
    return job;
  }
};

TEST_F(InputWorkerTest, OthersHaveWhatWaitsWhileARoundIsSampled) {
  InputWorker worker(connect("bridge"), Device::Cpu, {.views = 1, .pixels = 64, .samples = 100});
  EXPECT_FALSE(worker.take_waiting());
  worker.submit(long_job());
  worker.submit(job(2));
  worker.submit(job(3));
  std::optional<InputJob> taken;
  ASSERT_TRUE(bus_test::eventually([&] { return (taken = worker.take_waiting()).has_value(); }));
  EXPECT_EQ(taken->rig_generation, 2U);
  worker.take_back(std::move(*taken));
  taken = worker.take_waiting();
  ASSERT_TRUE(taken);
  EXPECT_EQ(taken->rig_generation, 2U) << "before the others again";
  // A newer round of the rig is there by now, and what is older needless; a look ahead replaces no round.
  worker.submit(job(2));
  worker.take_back(std::move(*taken));
  worker.submit(job(4, true));
  worker.take_back(job(4));
  worker.replace_by(job(3));
  std::vector<std::uint64_t> left;
  while ((taken = worker.take_waiting())) left.push_back(taken->rig_generation);
  EXPECT_EQ(left, (std::vector<std::uint64_t>{4, 2, 4}));
  EXPECT_EQ(worker.statistics().rounds, 0U) << "all this while the first was sampled";
}

}  // namespace
}  // namespace splatbus::capture_bridge::test

// Clone and split of a model in device memory beside the CPU's.
#include <set>

#include "cuda_optimizer_fixture.h"
#include "trainer/cuda/device_densifier.h"
#include "trainer/density.h"

namespace splatbus::trainer {
namespace {

constexpr DensifyOptions kOptions{
    .enabled = true, .interval_steps = 100, .gradient_threshold = 0.5F, .clone_max_scale_m = 0.1F};

/// Statistics as a few steps leave them.
struct Gathered {
  std::vector<float> sum;
  std::vector<std::uint32_t> steps;

  explicit Gathered(std::size_t count) : sum(count), steps(count) {}

  void observe(const raster::ParameterGradient& gradient) {
    for (std::size_t i = 0; i < sum.size(); ++i) {
      if (gradient.touched[i] == 0) continue;
      sum[i] += gradient.mean2d_norm[i];
      steps[i] += 1;
    }
  }
};

/// The same model in both kinds of memory, densified by each backend's own.
class CudaDensify : public bus_test::BusTest {
 protected:
  void SetUp() override {
    if (!has_device()) GTEST_SKIP() << "no CUDA device";
    bus_test::BusTest::SetUp();
  }

  void start(std::size_t count, std::size_t max_gaussians = 100000) {
    InsertBatch rows = sample_batch(1, 1, count);
    for (std::size_t i = 0; i < count; ++i) {
      const float size = i % 2 == 0 ? 0.2F : 0.05F;  // every other one is split
      for (std::size_t axis = 0; axis < 3; ++axis) {
        rows.log_scale[axis * count + i] = std::log(size / static_cast<float>(axis + 1));
      }
    }
    host_ = std::make_unique<ModelStore>(connect("host"), ParameterLayout{}, count, max_gaussians, Device::Cpu);
    device_ = std::make_unique<ModelStore>(connect("device"), ParameterLayout{}, count, max_gaussians, Device::Cuda);
    for (ModelStore* store : {host_.get(), device_.get()}) {
      store->change([&] { store->append(rows); });
    }
  }

  /// Of the store's Gaussians, some above the threshold, some below, some never seen.
  Gathered gather(Densifier& cpu) const {
    std::mt19937 random(4);
    std::uniform_real_distribution<float> uniform(0.0F, 1.0F);
    Gathered gathered(host_->count());
    cpu.resize(host_->count());
    for (int step = 0; step < 3; ++step) {
      raster::ParameterGradient gradient;
      gradient.clear_statistics(host_->view());
      for (std::size_t i = 0; i < gradient.count; ++i) {
        gradient.touched[i] = i % 7 != 0 && uniform(random) < 0.7F ? 1 : 0;
        gradient.mean2d_norm[i] = gradient.touched[i] != 0 ? uniform(random) : 0.0F;
      }
      cpu.observe(gradient);
      gathered.observe(gradient);
    }
    return gathered;
  }

  /// The columns that the device chose, which are densified there.
  std::vector<std::uint32_t> densify_on_device(const Gathered& gathered, std::uint64_t seed = 1) {
    cudaStream_t stream = nullptr;
    DeviceDensifier densifier(seed, stream);
    device::Buffer<float> sum;
    device::Buffer<std::uint32_t> steps;
    sum.upload(gathered.sum.data(), gathered.sum.size(), stream);
    steps.upload(gathered.steps.data(), gathered.steps.size(), stream);
    auto chosen =
        densifier.choose(*device_, {.mean2d_norm = sum.data(), .steps = steps.data()}, kOptions.gradient_threshold);
    device_->change([&] { densifier.densify(*device_, chosen, kOptions); });
    return chosen;
  }

  std::unique_ptr<ModelStore> host_, device_;
};

TEST_F(CudaDensify, ChoosesTheColumnsThatTheCpuDoes) {
  start(700);
  Densifier cpu(1);
  const Gathered gathered = gather(cpu);
  const HostPlanes before(*device_);
  host_->change([&] { cpu.densify(*host_, kOptions); });
  const auto chosen = densify_on_device(gathered);
  ASSERT_GT(chosen.size(), 50U);
  ASSERT_EQ(device_->count(), host_->count());
  ASSERT_EQ(device_->count(), 700 + chosen.size());
  const HostPlanes a(*device_);
  const HostPlanes b(*host_);
  EXPECT_EQ(a.ids(), b.ids());
  for (std::size_t c = 0; c < static_cast<std::size_t>(a->layout.channels()); ++c) {
    for (std::size_t i = 0; i < a.count(); ++i) {
      if (c >= ParameterLayout::kMean && c < 3) continue;  // of a split they are drawn
      ASSERT_NEAR(a->parameters[c * a->capacity + i], b->parameters[c * b->capacity + i], 1e-5F) << c << ", " << i;
    }
  }
  // Who is not chosen, or cloned, stays where it is, and so does its copy.
  for (std::size_t i = 0; i < a.count(); ++i) {
    const std::size_t from = i < before.count() ? i : chosen[i - before.count()];
    const bool is_chosen = std::binary_search(chosen.begin(), chosen.end(), from);
    const bool splits = is_chosen && from % 2 == 0;
    EXPECT_EQ(a->parameters[i] != before->parameters[from], splits) << i;
    EXPECT_EQ(a->parameters[i] != b->parameters[i], splits) << i;
  }
}

TEST_F(CudaDensify, ChildrenOfASplitAreDrawnFromIt) {
  constexpr std::size_t kCount = 3000;
  start(kCount);
  Gathered gathered(kCount);
  for (std::size_t i = 0; i < kCount; ++i) gathered.steps[i] = 1, gathered.sum[i] = 1;
  const HostPlanes before(*device_);
  const auto chosen = densify_on_device(gathered);
  const HostPlanes after(*device_);
  const auto at = [](const HostPlanes& planes, int channel, std::size_t i) {
    return planes->parameters[static_cast<std::size_t>(channel) * planes->capacity + i];
  };
  double sum[3] = {};
  double squares[3] = {};
  double products[3] = {};  // of the two children of one
  std::size_t children = 0;
  for (std::size_t k = 0; k < chosen.size(); ++k) {
    if (chosen[k] % 2 != 0) continue;
    float first[3];
    for (const std::size_t child : {std::size_t{chosen[k]}, kCount + k}) {
      const int q = ParameterLayout::kRotation;
      const glm::quat rotation = glm::normalize(glm::quat(at(before, q, chosen[k]), at(before, q + 1, chosen[k]),
                                                          at(before, q + 2, chosen[k]), at(before, q + 3, chosen[k])));
      glm::vec3 moved;
      for (int axis = 0; axis < 3; ++axis) moved[axis] = at(after, axis, child) - at(before, axis, chosen[k]);
      const glm::vec3 local = glm::inverse(rotation) * moved;
      for (int axis = 0; axis < 3; ++axis) {
        const int scale = ParameterLayout::kLogScale + axis;
        const float sigmas = local[axis] / std::exp(at(before, scale, chosen[k]));
        EXPECT_LT(std::abs(sigmas), 6.0F);
        EXPECT_NEAR(at(after, scale, child), at(before, scale, chosen[k]) - std::log(kSplitFactor), 1e-5F);
        sum[axis] += sigmas;
        squares[axis] += sigmas * sigmas;
        if (child < kCount) first[axis] = sigmas;
        if (child >= kCount) products[axis] += first[axis] * sigmas;
      }
      ++children;
    }
  }
  ASSERT_GT(children, kCount / 2);
  // Of standard normal draws, to five standard errors.
  const auto n = static_cast<double>(children);
  for (int axis = 0; axis < 3; ++axis) {
    EXPECT_NEAR(sum[axis] / n, 0.0, 5 / std::sqrt(n)) << axis;
    EXPECT_NEAR(squares[axis] / n, 1.0, 5 * std::sqrt(2 / n)) << axis;
    EXPECT_NEAR(2 * products[axis] / n, 0.0, 5 / std::sqrt(n / 2)) << axis;
  }
}

TEST_F(CudaDensify, TakesWhatThereIsRoomFor) {
  start(100, 110);
  Gathered gathered(100);
  for (std::size_t i = 0; i < 100; ++i) gathered.steps[i] = 1, gathered.sum[i] = 1;
  const HostPlanes before(*device_);
  const auto chosen = densify_on_device(gathered);
  EXPECT_EQ(device_->count(), 110U);
  const HostPlanes after(*device_);
  for (std::size_t k = 10; k < chosen.size(); ++k) {
    EXPECT_EQ(after->parameters[chosen[k]], before->parameters[chosen[k]]);
  }
}

TEST_F(CudaOptimizerTest, ClonesAndSplitsWhenAsked) {
  const Settings settings = {{"densify", "true"},
                             {"densify_interval", "6"},
                             {"densify_gradient", "4e-3"},
                             {"densify_scale", "0.03"},
                             {"prune_interval", "7"}};
  Trial cuda = trial(Device::Cuda, settings, 112);
  Trial cpu = trial(Device::Cpu, settings, 112);
  const std::size_t before = cuda.store().count();
  cuda.train(6);
  cpu.train(6);
  // Who is near the threshold may fall either way.
  EXPECT_GT(cuda.store().count(), before + before / 10);
  EXPECT_NEAR(static_cast<double>(cuda.store().count()), static_cast<double>(cpu.store().count()), 0.05 * 100);
  cuda.train(18);
  cpu.train(18);
  const auto ids = cuda.planes().ids();
  EXPECT_EQ(std::set<std::uint64_t>(ids.begin(), ids.end()).size(), cuda.store().count());
  EXPECT_GT(psnr(cuda, false), psnr(cpu, false) - 2);  // other draws
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

}  // namespace
}  // namespace splatbus::trainer

// The CUDA sampler against the CPU's: the same views, the same samples.
#include "cuda_rounds.h"

namespace splatbus::capture_bridge::test {
namespace {

/// Both samplers' answers on the host. The device does the host's operations, and sums are of integers, so that samples
/// agree one by one.
struct Comparison {
  const RoundSamples& expected;
  const RoundSamples& actual;

  template <class T>
  void equal(const T* RoundSamples::*array, std::size_t channels, float tolerance, const char* name) const {
    const auto a = on_host(actual.*array, channels * actual.size, actual.memory);
    const auto b = on_host(expected.*array, channels * expected.size, expected.memory);
    std::size_t different = 0;
    for (std::size_t i = 0; i < a.size(); ++i) {
      const double x = a[i];
      const double y = b[i];
      different += std::abs(x - y) <= tolerance * std::max(1.0, std::abs(y)) ? 0 : 1;
    }
    EXPECT_EQ(different, 0U) << name << " of " << a.size();
  }

  void check(std::size_t pixels) const {
    EXPECT_EQ(actual.dropped, expected.dropped);
    EXPECT_EQ(actual.cameras_per_surface, expected.cameras_per_surface);
    EXPECT_EQ(actual.valid, expected.valid);
    EXPECT_EQ(actual.culled, expected.culled);
    EXPECT_EQ(actual.thinned, expected.thinned);
    ASSERT_EQ(actual.size, expected.size);
    equal(&RoundSamples::position, 3, 1e-5F, "position");
    equal(&RoundSamples::normal, 3, 1e-5F, "normal");
    equal(&RoundSamples::albedo, 3, 1e-5F, "albedo");
    equal(&RoundSamples::color, 3, 1e-5F, "color");
    equal(&RoundSamples::spacing_m, 1, 1e-6F, "spacing");
    equal(&RoundSamples::object_id, 1, 0, "object id");
    equal(&RoundSamples::pixel, 1, 0, "pixel");
    const auto depth = on_host(actual.depth_m, pixels, actual.memory);
    const auto expected_depth = on_host(expected.depth_m, pixels, expected.memory);
    for (std::size_t i = 0; i < pixels; ++i) ASSERT_NEAR(depth[i], expected_depth[i], 1e-5F) << i;
  }
};

struct Named {
  const char* name;
  RoundCase (*make)();
};

/// One sampler takes all rounds, so that what one leaves behind does not show in the next.
class CudaSamplerTest : public CudaTest, public testing::WithParamInterface<Named> {
 protected:
  void SetUp() override {
    CudaTest::SetUp();
    if (!IsSkipped() && !gpu_) gpu_ = std::make_unique<Sampler>(Device::Cuda);
  }
  static void TearDownTestSuite() { gpu_.reset(); }

  static std::unique_ptr<Sampler> gpu_;
};
std::unique_ptr<Sampler> CudaSamplerTest::gpu_;

TEST_P(CudaSamplerTest, GivesTheSamplesOfTheCpu) {
  const RoundCase round = GetParam().make();
  const auto device_views = on_device(round.views);
  Sampler cpu(Device::Cpu);
  const RoundSamples expected = cpu.sample(pointers_to(round.views), round.objects, round.options);
  for (int repeat = 0; repeat < 2; ++repeat) {
    const RoundSamples actual = gpu_->sample(pointers_to(device_views), round.objects, round.options);
    EXPECT_EQ(actual.memory, Device::Cuda);
    Comparison{expected, actual}.check(round.views.size() * round.views.front().pixels());
  }
}

INSTANTIATE_TEST_SUITE_P(Rounds, CudaSamplerTest,
                         testing::Values(Named{"Dome", [] { return dome_round(12, 64, 60000); }},
                                         Named{"Thinned", [] { return dome_round(12, 64, 3000); }},
                                         Named{"OneSample", [] { return dome_round(4, 32, 1); }},
                                         Named{"NoBudget", [] { return dome_round(4, 32, 0); }},
                                         Named{"Live", [] { return dome_round(10, 128, 62500); }},
                                         Named{"LiveThinned", [] { return dome_round(10, 128, 25000); }},
                                         Named{"Default", [] { return dome_round(24, 64, 15000); }},
                                         Named{"Moving", moving_round}, Named{"Garbage", garbage_round},
                                         Named{"Odd", [] { return odd_round(37, 53); }},
                                         Named{"Thin", [] { return odd_round(300, 1); }},
                                         Named{"Pixel", [] { return odd_round(1, 1); }},
                                         Named{"Sky",
                                               [] {
                                                 const auto camera = look_at({0, 2, 0}, {0, 9, 1}, 16, 16, 0.5F);
                                                 return RoundCase{.views = AnalyticScene{}.render_all({camera})};
                                               }}),
                         [](const auto& test) { return test.param.name; });

class CudaSampling : public CudaTest {};

TEST_F(CudaSampling, OfNothingIsNothing) {
  Sampler gpu(Device::Cuda);
  EXPECT_EQ(gpu.sample({}, {}, {}).size, 0U);
}

}  // namespace
}  // namespace splatbus::capture_bridge::test

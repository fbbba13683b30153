#include <gmock/gmock.h>

#include <algorithm>
#include <array>
#include <random>

#include "algorithms.h"
#include "device/buffer.h"

namespace splatbus::device {

namespace {

using testing::ElementsAre;

class DeviceTest : public testing::TestWithParam<Device> {
 protected:
  void SetUp() override {
    if (GetParam() == Device::Cpu) return;
    try {
      static_cast<void>(Stream(Device::Cuda));
    } catch (const std::runtime_error& error) {
      GTEST_SKIP() << error.what();
    }
  }
};

TEST_P(DeviceTest, AFunctorRunsOnceForEachIndex) {
  const Stream stream(GetParam());
  const std::vector<float> values = reciprocals(stream, 100'000);
  ASSERT_EQ(values.size(), 100'000U);
  EXPECT_EQ(values[0], 1.0F);
  EXPECT_EQ(values[1], 0.5F);
  EXPECT_EQ(values[99'999], 1.0F / 100'000);
  EXPECT_TRUE(reciprocals(stream, 0).empty());
}

TEST_P(DeviceTest, AnAlgorithmOfThrustRunsWithScratchMemoryOfTheStream) {
  const Stream stream(GetParam());
  std::vector<std::uint32_t> values(50'000);
  std::mt19937 random(3);
  std::generate(values.begin(), values.end(), [&] { return static_cast<std::uint32_t>(random()); });
  const std::vector<std::uint32_t> result = sorted(stream, values);
  std::sort(values.begin(), values.end());
  EXPECT_EQ(result, values);
}

TEST_P(DeviceTest, ItemsAddToOneCounterWithoutLosingAny) {
  const Stream stream(GetParam());
  std::vector<std::uint32_t> values(300'000, 7);
  values[5] = 8;
  EXPECT_EQ(count_odd(stream, values), 299'999U);
}

TEST_P(DeviceTest, ABufferGrowsShrinksAndMoves) {
  const Stream stream(GetParam());
  Buffer<int> buffer(stream, 4);
  buffer.clear();
  EXPECT_THAT(buffer.to_host(), ElementsAre(0, 0, 0, 0));
  const std::array<int, 6> six = {1, 2, 3, 4, 5, 6};
  buffer.assign(six);
  EXPECT_THAT(buffer.to_host(), ElementsAre(1, 2, 3, 4, 5, 6));
  const int* const memory = buffer.data();
  buffer.resize(2);
  EXPECT_EQ(buffer.data(), memory);
  EXPECT_EQ(buffer.bytes(), 2 * sizeof(int));
  Buffer<int> moved = std::move(buffer);
  EXPECT_THAT(moved.to_host(), ElementsAre(1, 2));
  moved = Buffer<int>(stream);
  EXPECT_TRUE(moved.empty());
}

INSTANTIATE_TEST_SUITE_P(Devices, DeviceTest, testing::Values(Device::Cpu, Device::Cuda),
                         [](const auto& device) { return std::string(name_of(device.param)); });

}  // namespace

}  // namespace splatbus::device

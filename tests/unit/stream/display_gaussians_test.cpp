// Many changes that are given to a device at once are what they would be one after the other.
#include "stream/display_gaussians.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "device/memory.h"
#include "stream/quantized.h"
#include "stream/replicated_state.h"

namespace splatbus::stream {
namespace {

const StreamLayout kLayout(ParameterLayout{}, 1.0F / 1024);

class DisplayGaussiansOn : public testing::TestWithParam<Device> {
 protected:
  void SetUp() override {
    try {
      stream_.emplace(GetParam());
    } catch (const std::runtime_error& error) {
      GTEST_SKIP() << error.what();
    }
    display_.emplace(*stream_);
    changes_.add(DisplayReset{kLayout});
  }

  void blocks(std::uint32_t block, std::uint32_t count) { changes_.add(DisplayBlocks{{{block, count}}}); }
  void opacity(std::vector<std::uint32_t> rows, std::vector<std::int32_t> bytes) {
    changes_.add(DisplayValues{.attribute = Attribute::Opacity, .rows = std::move(rows), .values = std::move(bytes)});
  }
  /// All values of a row: this opacity, and the mean's first axis, in steps.
  void whole(std::uint32_t row, std::int32_t byte, std::int32_t steps) {
    QuantizedGaussians one;
    one.object_id = {7};
    one.channels.assign(static_cast<std::size_t>(kLayout.channels()), {0});
    one.channels[static_cast<std::size_t>(kLayout.at(Attribute::Opacity).first)] = {byte};
    one.channels[static_cast<std::size_t>(kLayout.at(Attribute::Mean).first)] = {steps};
    changes_.add(DisplayRows{{row}, one});
  }
  void apply() {
    display_->apply(changes_);
    changes_.clear();
  }
  float value(int channel, std::uint32_t row) {
    float value = 0;
    const GaussiansView view = display_->view();
    device::copy(*stream_, &value, view.parameters + static_cast<std::size_t>(channel) * view.stride + row,
                 sizeof(value));
    stream_->wait();
    return value;
  }
  int seen(std::size_t light, std::uint32_t row) {
    std::uint8_t seen = 0;
    const GaussiansView view = display_->view();
    device::copy(*stream_, &seen, view.visibility_u8 + light * view.visibility_stride + row, 1);
    stream_->wait();
    return seen;
  }
  /// In 255ths.
  float shown(std::uint32_t row) { return 255 / (1 + std::exp(-value(ParameterLayout::kOpacityLogit, row))); }

  std::optional<device::Stream> stream_;
  std::optional<DisplayGaussians> display_;
  DisplayChanges changes_;
};

TEST_P(DisplayGaussiansOn, TheLastOfTwoValuesStands) {
  blocks(0, 3);
  for (const std::uint32_t row : {0U, 1U, 2U}) whole(row, 100, 1024 * static_cast<std::int32_t>(row));
  opacity({2, 0}, {30, 10});
  opacity({0}, {200});
  whole(1, 50, -512);
  apply();
  EXPECT_NEAR(shown(0), 200, 0.01);
  EXPECT_NEAR(shown(1), 50, 0.01);
  EXPECT_NEAR(shown(2), 30, 0.01);
  EXPECT_EQ(value(0, 0), 0);
  EXPECT_EQ(value(0, 1), -0.5F);
  EXPECT_EQ(value(0, 2), 2);
  EXPECT_EQ(display_->count(), 3U);
}

TEST_P(DisplayGaussiansOn, TheLastStandsOfManyToo) {
  for (const std::uint32_t count : {1U << 17U, 1U << 20U}) {  // that are gathered, and that are not
    blocks(count / kBlockRows - 1, kBlockRows);
    std::vector<std::uint32_t> rows(count);
    std::iota(rows.begin(), rows.end(), 0U);
    opacity(rows, std::vector<std::int32_t>(count, 10));
    // Who wrote them at the same time would have written these first, and the others over half of them.
    std::ranges::reverse(rows);
    opacity(rows, std::vector<std::int32_t>(count, 200));
    apply();
    for (std::uint32_t row = 0; row < count; row += 997) ASSERT_NEAR(shown(row), 200, 0.01) << row;
  }
}

TEST_P(DisplayGaussiansOn, AnotherModelBeginsWithNothing) {
  blocks(0, 2);
  for (const std::uint32_t row : {0U, 1U}) whole(row, 100, 0);
  changes_.add(DisplayReset{kLayout});
  blocks(0, 1);
  whole(0, 70, 1024);
  apply();
  EXPECT_NEAR(shown(0), 70, 0.01);
  EXPECT_EQ(shown(1), 0);
  EXPECT_EQ(display_->count(), 1U);
}

TEST_P(DisplayGaussiansOn, WhatIsPendingOutlivesGrowth) {
  blocks(0, 1);
  whole(0, 100, 1024);
  changes_.add(DisplayLights{{4}});
  changes_.add(DisplaySeen{4, {0}, {40}});
  blocks(1000, 1);  // the rows grow
  whole(1000 * kBlockRows, 60, 2048);
  changes_.add(DisplaySeen{4, {1000 * kBlockRows}, {44}});
  apply();
  EXPECT_NEAR(shown(0), 100, 0.01);
  EXPECT_EQ(value(0, 0), 1);
  EXPECT_NEAR(shown(1000 * kBlockRows), 60, 0.01);
  EXPECT_EQ(value(0, 1000 * kBlockRows), 2);
  EXPECT_EQ(seen(1, 0), 40);
  EXPECT_EQ(seen(1, 1000 * kBlockRows), 44);
}

TEST_P(DisplayGaussiansOn, RowsThatABlockLeavesAreNotSeenUntilOthersHaveThem) {
  blocks(0, 4);
  for (const std::uint32_t row : {0U, 1U, 2U, 3U}) whole(row, 100, 0);
  opacity({2}, {60});
  blocks(0, 1);  // after its values
  whole(3, 80, 0);
  blocks(0, 4);
  apply();
  EXPECT_NEAR(shown(0), 100, 0.01);
  EXPECT_EQ(shown(1), 0);
  EXPECT_EQ(shown(2), 0);
  EXPECT_NEAR(shown(3), 80, 0.01);

  blocks(0, 2);
  blocks(0, 0);
  apply();
  for (const std::uint32_t row : {0U, 1U, 2U, 3U}) EXPECT_EQ(shown(row), 0) << row;
  EXPECT_EQ(display_->count(), 0U);
}

TEST_P(DisplayGaussiansOn, WhatLightsShowFollowsTheirOrder) {
  blocks(0, 1);
  whole(0, 100, 0);
  changes_.add(DisplayLights{{4, 9}});
  changes_.add(DisplaySeen{4, {0}, {40}});
  changes_.add(DisplaySeen{9, {0}, {90}});
  changes_.add(DisplaySeen{4, {0}, {41}});
  changes_.add(DisplayLights{{9, 12}});
  changes_.add(DisplaySeen{12, {0}, {120}});
  apply();
  ASSERT_EQ(display_->view().visibility_rows, 3U);
  EXPECT_EQ(seen(1, 0), 90);
  EXPECT_EQ(seen(2, 0), 120);
}

INSTANTIATE_TEST_SUITE_P(Devices, DisplayGaussiansOn, testing::Values(Device::Cpu, Device::Cuda),
                         [](const auto& of) { return std::string(name_of(of.param)); });

}  // namespace
}  // namespace splatbus::stream

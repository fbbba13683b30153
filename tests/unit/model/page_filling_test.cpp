// A model that nobody trains, put into a store whole.
#include "model/page_filling.h"

#include <cmath>
#include <limits>
#include <set>

#include "page_store_fixture.h"

namespace splatbus::model {

namespace {

constexpr ParameterLayout kLayout{Appearance::Radiance, 2};

/// Two clouds a metre across, 50 m apart, in no order, of which every other one is of an object.
GaussiansBuffer clouds(std::size_t count, std::uint32_t object) {
  std::mt19937 random(3);
  std::uniform_real_distribution<float> uniform(-0.5F, 0.5F);
  GaussiansBuffer gaussians(kLayout, count);
  const std::size_t stride = gaussians.stride();
  for (float& value : gaussians.parameters) value = uniform(random);
  for (std::size_t i = 0; i < count; ++i) {
    gaussians.parameters[i] += i % 3 == 0 ? 50.0F : 0.0F;
    gaussians.object_id[i] = i % 2 == 0 ? kWorldFrame : object;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      gaussians.normal[axis * stride + i] = uniform(random);
      gaussians.surface_point[axis * stride + i] = gaussians.parameters[axis * stride + i];
    }
    gaussians.visibility[i] = uniform(random);
  }
  return gaussians;
}

class PageFillingTest : public PageStoreTest {
 protected:
  /// As fill_frozen() is to number them.
  void expect(const GaussiansBuffer& gaussians, const std::set<std::size_t>& left_out = {}) {
    for (std::size_t i = 0; i < gaussians.count(); ++i) {
      if (left_out.contains(i)) continue;
      Gaussian& gaussian = truth_.gaussians[i + 1];
      gaussian.frame_id = gaussians.object_id[i];
      const auto add = [&](const std::vector<float>& planes, std::size_t channels) {
        for (std::size_t c = 0; c < channels; ++c) gaussian.values.push_back(planes[c * gaussians.stride() + i]);
      };
      for (int copy = 0; copy < 2; ++copy) add(gaussians.parameters, static_cast<std::size_t>(kLayout.channels()));
      add(gaussians.normal, 3);
      add(gaussians.surface_point, 3);
      add(gaussians.visibility, 1);
    }
  }
};

TEST_P(PageFillingTest, AllOfItIsThereAsItWasFrozenAndInTheOrderOfTheCurve) {
  constexpr std::size_t kCount = 150'000;  // more pages than are put in at a time, more than an arena has
  const GaussiansBuffer gaussians = clouds(kCount, 7);
  start(kCount, kLayout);
  EXPECT_EQ(fill_frozen(*store_, gaussians.view()), kCount);
  expect(gaussians);
  expect_sound();
  EXPECT_EQ(store_->frozen_count(), kCount);
  EXPECT_EQ(store_->page_count(), 2 * ((kCount / 2 + kPageLanes - 1) / kPageLanes)) << "pages are full";
  std::size_t apart = 0;
  for (const PageBounds& bounds : store_->view().bounds) apart += bounds.high.x - bounds.low.x > 10 ? 1 : 0;
  EXPECT_LT(apart, store_->page_count() / 5) << "what is in one page lies together, but where the curve leaves a cloud";
}

TEST_P(PageFillingTest, WhatIsNotFiniteIsLeftOut) {
  GaussiansBuffer gaussians = clouds(3000, 7);
  gaussians.parameters[10] = std::numeric_limits<float>::quiet_NaN();
  gaussians.parameters[20] = std::numeric_limits<float>::infinity();
  gaussians.parameters[15 * gaussians.stride() + 30] = std::numeric_limits<float>::quiet_NaN();  // of its colour
  start(3000, kLayout);
  EXPECT_EQ(fill_frozen(*store_, gaussians.view()), 2997U);
  expect(gaussians, {10, 20, 30});
  expect_sound();
}

TEST_P(PageFillingTest, NothingIsNoModel) {
  start(100, kLayout);
  EXPECT_EQ(fill_frozen(*store_, GaussiansBuffer(kLayout).view()), 0U);
  EXPECT_EQ(store_->count(), 0U);
}

INSTANTIATE_TEST_SUITE_P(Devices, PageFillingTest, testing::Values(Device::Cpu, Device::Cuda), device_name);

}  // namespace

}  // namespace splatbus::model

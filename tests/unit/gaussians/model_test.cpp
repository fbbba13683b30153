#include "gaussians/model.h"

#include <gtest/gtest.h>

#include "random.h"

namespace splatbus {
namespace {

TEST(ParameterLayout, CountsChannels) {
  EXPECT_EQ((ParameterLayout{Appearance::Transfer, 3}.channels()), 41);
  EXPECT_EQ((ParameterLayout{Appearance::Radiance, 0}.channels()), 14);
  EXPECT_EQ((ParameterLayout{Appearance::Radiance, 1}.channels()), 23);
  EXPECT_EQ((ParameterLayout{Appearance::Radiance, 2}.channels()), 38);
  EXPECT_EQ((ParameterLayout{Appearance::Radiance, 3}.channels()), 59);
}

TEST(GaussiansBuffer, IsEmptyAtFirst) {
  const GaussiansBuffer buffer;
  EXPECT_EQ(buffer.count(), 0U);
  EXPECT_EQ(buffer.view().count, 0U);
  EXPECT_EQ(buffer.layout(), ParameterLayout{});
}

TEST(GaussiansBuffer, ResizeKeepsValuesAndClearsNewOnes) {
  GaussiansBuffer buffer;
  const auto channels = static_cast<std::size_t>(buffer.layout().channels());
  for (std::size_t count = 1; count <= 100; ++count) {
    buffer.resize(count);
    for (std::size_t c = 0; c < channels; ++c) {
      float& last = buffer.parameters[c * buffer.stride() + count - 1];
      EXPECT_EQ(last, 0) << "channel " << c << ", Gaussian " << count - 1;
      last = static_cast<float>(1000 * c + count);
    }
    EXPECT_EQ(buffer.gaussian_id[count - 1], 0U);
    buffer.gaussian_id[count - 1] = count;
  }
  buffer.resize(10);
  buffer.resize(40);
  for (std::size_t i = 0; i < 40; ++i) {
    for (std::size_t c = 0; c < channels; ++c) {
      EXPECT_EQ(buffer.parameters[c * buffer.stride() + i], i < 10 ? static_cast<float>(1000 * c + i + 1) : 0.0F);
    }
    EXPECT_EQ(buffer.gaussian_id[i], i < 10 ? i + 1 : 0U);
  }
  EXPECT_GE(buffer.stride(), buffer.count());
  EXPECT_EQ(buffer.normal.size(), 3 * buffer.stride());
}

TEST(GaussiansBuffer, CopiesAViewWithAWiderStride) {
  test::Random random(9);
  GaussiansBuffer wide = random.gaussians({}, 20);
  GaussiansView view = wide.view();
  view.count = 13;
  const GaussiansBuffer copy = GaussiansBuffer::copy_of(view);
  ASSERT_EQ(copy.count(), 13U);
  for (std::size_t i = 0; i < copy.count(); ++i) {
    for (int c = 0; c < copy.layout().channels(); ++c) EXPECT_EQ(copy.view().plane(c)[i], view.plane(c)[i]);
    for (std::size_t axis = 0; axis < 3; ++axis) {
      EXPECT_EQ(copy.normal[axis * copy.stride() + i], wide.normal[axis * wide.stride() + i]);
      EXPECT_EQ(copy.surface_point[axis * copy.stride() + i], wide.surface_point[axis * wide.stride() + i]);
    }
    EXPECT_EQ(copy.visibility[i], wide.visibility[i]);
    EXPECT_EQ(copy.object_id[i], wide.object_id[i]);
    EXPECT_EQ(copy.flags[i], wide.flags[i]);
    EXPECT_EQ(copy.gaussian_id[i], wide.gaussian_id[i]);
  }
}

TEST(GaussiansBuffer, AbsentPlanesBecomeZeroAndTheSurfacePointTheMean) {
  test::Random random(10);
  const GaussiansBuffer source = random.gaussians({Appearance::Radiance, 1}, 5);
  GaussiansView view;
  view.layout = source.layout();
  view.count = source.count();
  view.stride = source.stride();
  view.parameters = source.parameters.data();
  const GaussiansBuffer copy = GaussiansBuffer::copy_of(view);
  for (std::size_t i = 0; i < copy.count(); ++i) {
    EXPECT_EQ(copy.normal[i], 0);
    EXPECT_EQ(copy.object_id[i], 0U);
    for (int axis = 0; axis < 3; ++axis) {
      EXPECT_EQ(copy.surface_point[static_cast<std::size_t>(axis) * copy.stride() + i], view.plane(axis)[i]);
    }
  }
}

}  // namespace
}  // namespace splatbus

// Pages that a picture's surfaces hide have no part in a step on it.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <optional>
#include <vector>

#include "../../model/device_test.h"
#include "device/buffer.h"
#include "optimizer_fixture.h"
#include "trainer/farthest_surfaces.h"

namespace splatbus::trainer {
namespace {

class HiddenPages : public OptimizerTest, public testing::WithParamInterface<Device> {
 protected:
  void SetUp() override {
    if (!has_device(GetParam())) GTEST_SKIP() << "no such device";
    stream_.emplace(GetParam());
  }

  [[nodiscard]] std::vector<float> farthest(const std::vector<float>& depth_m, std::uint32_t width,
                                            std::uint32_t height) {
    device::Buffer<float> depth(*stream_), out(*stream_, surface_squares(width, height));
    depth.assign(std::span(depth_m));
    find_farthest_surfaces(*stream_, depth.data(), width, height, out.data());
    return out.to_host();
  }

  /// The scene's first view as of a camera with a hand before it, where anything is `at_m` away.
  [[nodiscard]] TrainingView covered(float at_m) {
    TrainingView view = *scene_.views()[0];
    const std::vector<float> depth_m(view.depth.size(), at_m);
    view.farthest_m = Pixels<float>(farthest(depth_m, view.camera.width, view.camera.height));
    return view;
  }

  /// How far five steps on the view move the model.
  [[nodiscard]] double moved_by(const TrainingView& view, const Settings& settings) {
    Trial one = trial(GetParam(), settings);
    const HostModel before = one.model();
    for (int k = 0; k < 5; ++k) one.step({&view});
    one.optimizer().finish();
    return distance(one.model().live(), before.live(), ParameterLayout::kResidual);
  }

  std::optional<device::Stream> stream_;
};

TEST_P(HiddenPages, TheFarthestOfASquareAndOfThePixelsAboutIt) {
  constexpr std::uint32_t kWidth = 19, kHeight = 10;
  std::vector<float> depth_m(std::size_t{kWidth} * kHeight, 2.0F);
  depth_m[7 * kWidth + 8] = 5;     // in the second square, beside the first and above the lower two
  depth_m[9 * kWidth + 18] = 0;    // no surface in the last
  depth_m[0 * kWidth + 17] = NAN;  // nor a number in the upper right one
  depth_m[3 * kWidth + 3] = 0.5F;  // nearer than all about it
  const std::vector<float> expected{5, 5, INFINITY, 5, 5, INFINITY};
  EXPECT_EQ(farthest(depth_m, kWidth, kHeight), expected);
}

TEST_P(HiddenPages, WhatIsHiddenDoesNotLearn) {
  EXPECT_EQ(moved_by(covered(0.02F), {}), 0);
  EXPECT_GT(moved_by(covered(0.02F), {{"cull_hidden", "false"}}), 1e-4);
  EXPECT_GT(moved_by(covered(0.02F), {{"cull", "false"}}), 1e-4);
  EXPECT_GT(moved_by(covered(100), {}), 1e-4) << "a wall behind everything hides nothing";
  EXPECT_GT(moved_by(covered(0), {}), 1e-4) << "and neither does the sky";
}

TEST_P(HiddenPages, WhatShowsBesideAWallLearns) {
  TrainingView view = *scene_.views()[0];
  const std::uint32_t width = view.camera.width, height = view.camera.height;
  for (const bool wall_at_left : {false, true}) {
    // All but one column of squares: the page reaches beyond it on either side.
    std::vector<float> depth_m(std::size_t{width} * height, 0.02F);
    for (std::uint32_t row = 0; row < height; ++row) {
      depth_m[std::size_t{row} * width + (wall_at_left ? width / 2 + 4 : width / 2 - 4)] = 0;
    }
    view.farthest_m = Pixels<float>(farthest(depth_m, width, height));
    EXPECT_GT(moved_by(view, {}), 1e-4) << wall_at_left;
  }
}

INSTANTIATE_TEST_SUITE_P(Devices, HiddenPages, testing::Values(Device::Cpu, Device::Cuda),
                         [](const auto& of) { return of.param == Device::Cpu ? "Cpu" : "Cuda"; });

}  // namespace
}  // namespace splatbus::trainer

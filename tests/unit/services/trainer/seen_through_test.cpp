// Which of two depth pictures show a scene in which something has come or gone. The truth is a room with a box in it,
// whose depth is found ray by ray.
#include "trainer/seen_through.h"

#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <optional>
#include <vector>

#include "../../model/device_test.h"
#include "device/buffer.h"
#include "device/memory.h"
#include "sample_batch.h"

namespace splatbus::trainer {
namespace {

struct Box {
  glm::vec3 low, high;
};

/// Along the ray, in units of its direction; infinity where it misses.
float hit(const Box& box, const glm::vec3& from, const glm::vec3& along) {
  float enter = 0, leave = INFINITY;
  for (int axis = 0; axis < 3; ++axis) {
    const float a = (box.low[axis] - from[axis]) / along[axis], b = (box.high[axis] - from[axis]) / along[axis];
    enter = std::max(enter, std::min(a, b));
    leave = std::min(leave, std::max(a, b));
  }
  return enter < leave && enter > 0 ? enter : INFINITY;
}

const Box kFloor{{-20, -1, -20}, {20, 0, 20}}, kWall{{-20, 0, 6}, {20, 2, 7}}, kThing{{0.2F, 0, 3}, {0.6F, 0.4F, 3.4F}};

std::vector<Box> room() {
  return {kFloor, kWall};
}
std::vector<Box> with(std::vector<Box> scene, const Box& box) {
  scene.push_back(box);
  return scene;
}

class SeenThroughOn : public testing::TestWithParam<Device> {
 protected:
  void SetUp() override {
    if (!has_device(GetParam())) GTEST_SKIP() << "no such device";
    stream_.emplace(GetParam());
  }

  template <class T>
  Pixels<T> on_device(const std::vector<T>& values) {
    auto owner = std::make_shared<device::Buffer<T>>(*stream_);
    owner->assign(std::span(values));
    return Pixels<T>({owner, owner->data()}, values.size());
  }

  /// 160 x 120 pixels; what `masked` covers is masked.
  TrainingViewPtr view(const std::vector<Box>& scene, const glm::vec3& eye, const glm::vec3& target,
                       const Box* masked = nullptr) {
    TrainingView view;
    view.camera = look_at(eye, target, 160, 120, 1);
    view.memory = GetParam();
    std::vector<float> depth;
    std::vector<std::uint8_t> mask;
    for (std::uint32_t row = 0; row < view.camera.height; ++row) {
      for (std::uint32_t column = 0; column < view.camera.width; ++column) {
        // A metre along z, so that the ray's parameter is the depth.
        const glm::vec3 along = view.camera.world_from_camera.rotation *
                                glm::vec3((static_cast<float>(column) + 0.5F - view.camera.cx) / view.camera.fx,
                                          (static_cast<float>(row) + 0.5F - view.camera.cy) / view.camera.fy, 1);
        float nearest = INFINITY;
        for (const Box& box : scene) nearest = std::min(nearest, hit(box, eye, along));
        mask.push_back(masked != nullptr && hit(*masked, eye, along) <= nearest ? 255 : 0);
        depth.push_back(std::isfinite(nearest) ? nearest : 0);
      }
    }
    view.depth = on_device(depth);
    if (masked != nullptr) view.mask = on_device(mask);
    return std::make_shared<const TrainingView>(std::move(view));
  }

  SeenThrough compare(const TrainingViewPtr& newer, const TrainingViewPtr& kept) {
    return seen_through(*stream_, *newer, std::vector{kept}).front();
  }

  std::optional<device::Stream> stream_;
};

const glm::vec3 kEye{0, 1.6F, 0}, kAhead{0, 1, 6}, kAside{1.5F, 1.2F, 0.5F}, kBehind{-1, 1.8F, -4},
    kAcross{-4, 1.5F, 3};

TEST_P(SeenThroughOn, OneSceneFromAnywhereIsTheSame) {
  const auto scene = with(room(), kThing);
  const auto ahead = view(scene, kEye, kAhead);
  for (const glm::vec3& eye : {kAside, kBehind, kAcross}) {
    for (const glm::vec3& target : {kAhead, glm::vec3(0.4F, 0.2F, 3.2F), glm::vec3(3, 0, 5)}) {
      const SeenThrough seen = compare(ahead, view(scene, eye, target));
      EXPECT_GT(seen.judged, 100U);
      EXPECT_FALSE(seen.differs()) << seen.through << " of " << seen.judged;
    }
  }
}

TEST_P(SeenThroughOn, WhatHasComeOrGoneShows) {
  const auto before = view(room(), kAside, kAhead), after = view(with(room(), kThing), kEye, kAhead);
  EXPECT_TRUE(compare(after, before).differs()) << "it has come";
  EXPECT_TRUE(compare(before, after).differs()) << "it has gone";
  // The sky above the wall, where nothing is at all.
  const Box tower{{-0.5F, 2, 5}, {0.5F, 4, 5.5F}};
  EXPECT_TRUE(compare(view(with(room(), tower), kEye, {0, 2, 6}), view(room(), kAside, {0, 2, 6})).differs());
}

TEST_P(SeenThroughOn, WhatLiesBeyondAFarPlaneIsNotGone) {
  // The wall is 6 m from one, and 10 m from the other, who sees 8 m.
  auto far = std::make_shared<TrainingView>(*view(room(), {0, 1.6F, -4}, kAhead));
  far->camera.far_m = 8;
  std::vector<float> depth(far->depth.size());
  device::copy(*stream_, depth.data(), far->depth.data(), far->depth.bytes());
  stream_->wait();
  for (float& depth_m : depth) depth_m = depth_m < far->camera.far_m ? depth_m : 0;
  far->depth = on_device(depth);
  const SeenThrough seen = compare(view(room(), kEye, kAhead), far);
  EXPECT_GT(seen.judged, 10U);
  EXPECT_FALSE(seen.differs()) << seen.through << " of " << seen.judged;
}

TEST_P(SeenThroughOn, EachOfThemIsJudgedAlone) {
  const auto now = view(with(room(), kThing), kEye, kAhead);
  const auto seen = seen_through(*stream_, *now,
                                 std::vector{view(room(), kAside, kAhead), view(with(room(), kThing), kAside, kAhead),
                                             view(room(), kAside, kAhead)});
  ASSERT_EQ(seen.size(), 3U);
  EXPECT_TRUE(seen[0].differs());
  EXPECT_FALSE(seen[1].differs());
  EXPECT_TRUE(seen[2].differs());
}

TEST_P(SeenThroughOn, WhatIsMaskedSaysNothing) {
  const auto scene = with(room(), kThing);
  const Box away{kThing.low - 0.1F, kThing.high + 0.1F};
  EXPECT_FALSE(compare(view(scene, kEye, kAhead, &kThing), view(room(), kAside, kAhead)).differs())
      << "in the picture that shows it";
  EXPECT_FALSE(compare(view(scene, kEye, kAhead), view(room(), kAside, kAhead, &away)).differs())
      << "in the picture that looks through it";
}

/// Posts of that width, 3 m ahead.
std::vector<Box> fence(float width_m, float apart_m) {
  auto scene = room();
  for (float x = -6; x < 6; x += apart_m) scene.push_back({{x, 0, 3}, {x + width_m, 1.5F, 3 + width_m}});
  return scene;
}

TEST_P(SeenThroughOn, WhatPixelsMissIsNotGone) {
  const auto expect_same = [&](const std::vector<Box>& scene, const glm::vec3& other) {
    const SeenThrough seen = compare(view(scene, {0, 1, 0.5F}, {0, 0.8F, 3}), view(scene, other, {0, 0.8F, 3}));
    EXPECT_FALSE(seen.differs()) << seen.through << " of " << seen.judged;
    return seen.judged;
  };
  expect_same(fence(0.15F, 1), {0.3F, 1.2F, -40});      // 7 pixels here, a third of one there
  expect_same(fence(0.01F, 0.1F), {0.4F, 1.2F, 0.4F});  // half a pixel from everywhere
}

INSTANTIATE_TEST_SUITE_P(Devices, SeenThroughOn, testing::Values(Device::Cpu, Device::Cuda), model::device_name);

}  // namespace
}  // namespace splatbus::trainer

// Carving through the optimizer, on either device: a wall over a floor, which the engine's depth shows alone.
#include <algorithm>

#include "optimizer_fixture.h"

namespace splatbus::trainer {
namespace {

constexpr float kFloor_m = 0.05F, kHalfSide_m = 2.4F;

class CarvingTest : public OptimizerTest, public testing::WithParamInterface<Device> {
 protected:
  void SetUp() override {
    if (!has_device(GetParam())) GTEST_SKIP() << "no such device";
  }

  Trial trial(const Settings& settings = {}) { return OptimizerTest::trial(GetParam(), settings, 1U << 14U); }

  /// Small Gaussians in a horizontal square.
  static SampleBatch square(std::uint64_t batch_id, std::size_t count, float height_m) {
    SampleBatch batch = sample_batch(1, batch_id, count, static_cast<unsigned>(batch_id));
    for (std::size_t i = 0; i < count; ++i) {
      batch.mean[i] *= 0.4F;
      batch.mean[count + i] = height_m;
      batch.mean[2 * count + i] *= 0.4F;
    }
    std::fill(batch.log_scale.begin(), batch.log_scale.end(), std::log(0.06F));
    return batch;
  }

  /// What all cameras see of a square surface at that height.
  std::vector<TrainingViewPtr> pictures(std::uint64_t frame, float height_m = kFloor_m) {
    std::vector<TrainingViewPtr> all;
    for (const TrainingViewPtr& seen : scene_.views()) {
      TrainingView view = *seen;
      view.frame = frame;
      std::vector<float> depth;
      for (std::uint32_t row = 0; row < view.camera.height; ++row) {
        for (std::uint32_t column = 0; column < view.camera.width; ++column) {
          const float x = static_cast<float>(column) + 0.5F, y = static_cast<float>(row) + 0.5F;
          const glm::vec3 eye = view.camera.world_from_camera.translation;
          const glm::vec3 along = unproject(view.camera, x, y, 1) - eye;
          const float z = (height_m - eye.y) / along.y;
          const glm::vec3 at = eye + z * along;
          const bool hit = z > 0 && std::abs(at.x) < kHalfSide_m && std::abs(at.z) < kHalfSide_m;
          depth.push_back(hit ? z : 0);
        }
      }
      view.depth = Pixels<float>(std::move(depth));
      all.push_back(placed(view, GetParam()));
    }
    return all;
  }

  static bool look(Trial& trial, const std::vector<TrainingViewPtr>& pictures) {
    Commands commands;
    for (const TrainingViewPtr& view : pictures) commands.look(view);
    bool changed = trial.optimizer().apply(commands);
    trial.optimizer().finish();
    changed |= trial.optimizer().apply({});
    return changed;
  }
};

TEST_P(CarvingTest, WhatStandsInFreeSpaceGoesAndTheSurfaceStays) {
  Trial s = trial();
  const auto floor = s.model().ids();
  s.insert(square(2, 150, 1));
  EXPECT_FALSE(look(s, pictures(10)));
  s.train(2);
  EXPECT_FALSE(look(s, pictures(10))) << "the same engine frame";
  EXPECT_EQ(s.model().count(), floor.size() + 150);
  EXPECT_TRUE(look(s, pictures(11)));
  EXPECT_EQ(s.model().ids(), floor);
  EXPECT_EQ(s.model().listed(), floor.size());
  EXPECT_EQ(s.optimizer().carved(), 150U);
  s.train(2);
  for (std::uint64_t frame = 12; frame < 20; ++frame) EXPECT_FALSE(look(s, pictures(frame)));
  EXPECT_EQ(s.model().ids(), floor);
}

TEST_P(CarvingTest, VotesStayWithAGaussianThatMoves) {
  Trial s = trial({{"carve_votes", "3"}});
  s.insert(square(2, 150, 1));
  look(s, pictures(10));
  look(s, pictures(11));
  const HostModel before = s.model();
  s.insert(square(3, 1500, -1));  // under the floor; over a page's room
  const HostModel after = s.model();
  std::size_t moved = 0;
  for (std::size_t k = 0; k < before.count(); ++k) moved += before.index(k) != after.index(k) ? 1 : 0;
  ASSERT_GT(moved, 100U);
  EXPECT_TRUE(look(s, pictures(12)));
  EXPECT_EQ(s.optimizer().carved(), 150U);
  std::vector<std::uint64_t> expected = after.ids();
  expected.erase(expected.begin() + 100, expected.begin() + 250);
  EXPECT_EQ(s.model().ids(), expected);
}

TEST_P(CarvingTest, WhatAppearsWhereSomethingWasCarvedIsANewSurface) {
  Trial s = trial();
  s.insert(square(2, 150, 1));
  look(s, pictures(10));
  look(s, pictures(11));
  ASSERT_EQ(s.optimizer().carved(), 150U);
  s.insert(square(3, 150, 1));
  look(s, pictures(12));  // of before it appeared
  for (std::uint64_t frame = 13; frame < 20; ++frame) look(s, pictures(frame, 1));
  look(s, pictures(20));
  EXPECT_EQ(s.optimizer().carved(), 150U);
  EXPECT_EQ(s.model().count(), 250U);
}

TEST_P(CarvingTest, OnlyWhenAskedFor) {
  Trial s = trial({{"carve", "false"}});
  s.insert(square(2, 150, 1));
  for (std::uint64_t frame = 10; frame < 14; ++frame) look(s, pictures(frame));
  EXPECT_EQ(s.optimizer().carved(), 0U);
  EXPECT_EQ(s.model().count(), 250U);
  s.set("carve", "true");
  look(s, pictures(14));
  look(s, pictures(15));
  EXPECT_EQ(s.optimizer().carved(), 150U);
}

INSTANTIATE_TEST_SUITE_P(Devices, CarvingTest, testing::Values(Device::Cpu, Device::Cuda),
                         [](const auto& device) { return std::string(name_of(device.param)); });

TEST(Commands, HoldTheNewestPictureOfACameraThatBringsDepth) {
  const auto view = [](std::uint32_t camera, std::uint64_t frame, CameraRole role = CameraRole::Reference) {
    auto made = std::make_shared<TrainingView>();
    made->camera.id = camera;
    made->camera.role = role;
    made->frame = frame;
    made->depth = Pixels<float>(std::vector<float>{1});
    return made;
  };
  Commands commands;
  EXPECT_TRUE(commands.empty());
  auto colour_alone = view(5, 1);
  colour_alone->depth = {};
  commands.look(colour_alone);
  EXPECT_TRUE(commands.empty());
  commands.look(view(1, 10));
  EXPECT_FALSE(commands.empty());
  commands.look(view(2, 10));
  commands.look(view(1, 10, CameraRole::Input));
  commands.look(view(1, 11));
  ASSERT_EQ(commands.pictures.size(), 3U);
  EXPECT_EQ(commands.pictures[0]->frame, 11U);
}

}  // namespace
}  // namespace splatbus::trainer

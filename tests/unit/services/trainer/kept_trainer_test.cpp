// What a trainer keeps of where cameras stood, as its heartbeats tell it.
#include <gtest/gtest.h>

#include <cstdint>
#include <vector>

#include "bus/heartbeat_thread.h"
#include "trainer_fixture.h"

namespace splatbus::trainer {
namespace {

TEST_F(TrainerTest, WhereACameraStoodIsKeptUntilTheSceneIsAnother) {
  const SyntheticScene scene;
  start();
  bus::HeartbeatThread heartbeats(*service_, "trainer");
  insert(scene.truth());
  std::uint64_t frame = 10;
  const auto stand_at = [&](TrainingView view, std::uint64_t version) {
    view.camera.id = 0;
    view.frame = ++frame;
    view.scene.version = version;
    publish_view(view);
  };
  ASSERT_TRUE(until([&] {
    stand_at(*scene.views()[frame % 2 == 0 ? 1 : 3], 5);
    return counter("kept_views") == 2;
  }));
  EXPECT_EQ(counter("untrue_views"), 0);
  // The floor has gone, and with it those that show it.
  TrainingView empty = *scene.views()[2];
  empty.depth = Pixels<float>(std::vector<float>(empty.depth.size(), 0.0F));
  ASSERT_TRUE(until([&] {
    stand_at(empty, 5);
    return counter("untrue_views") >= 2;
  }));
  ASSERT_TRUE(until([&] {
    stand_at(*scene.views()[frame % 2 == 0 ? 1 : 3], 6);
    return counter("kept_views") == 2;
  }));
  ASSERT_TRUE(until([&] {
    stand_at(*scene.views()[1], 7);
    return counter("kept_views") < 2;
  }));
}

}  // namespace
}  // namespace splatbus::trainer

#include "stream/color_times.h"

#include <gtest/gtest.h>

#include "toy_server.h"

namespace splatbus::stream {
namespace {

using test::ToyServer;

class ColorTimesTest : public ::testing::Test {
 protected:
  ColorTimesTest() { test::join(server_.stream, replica_); }

  /// The next scene, in another light.
  void send_scene(std::int64_t capture_ns) {
    server_.scene.light.sun_irradiance.x += 0.1F;
    ++server_.scene.version;
    test::send(server_.stream.take_scene(server_.scene, {.frame = server_.scene.version, .capture_ns = capture_ns}),
               replica_);
    times_.see(replica_);
  }
  void send_visibility(std::uint64_t version) {
    seen_.assign(server_.model().count(), static_cast<std::uint8_t>(10 * version));
    test::send(server_.take_visibility(seen_, version), replica_);
    ASSERT_EQ(replica_.visibility_version(), version);
    times_.see(replica_);
  }
  std::int64_t taken(bool more = false) { return times_.taken(replica_, more); }

  ToyServer server_{3, 300};
  Replica replica_;
  ColorTimes times_;
  std::vector<std::uint8_t> seen_;
};

TEST_F(ColorTimesTest, AreTheScenesAndThenItsVisibilitys) {
  send_scene(2000);
  EXPECT_EQ(taken(), 2000);
  send_scene(3000);
  EXPECT_EQ(taken(), 3000) << "the light is another";
  send_visibility(2);
  EXPECT_EQ(taken(), 2000) << "shadows alone, of the scene before";
  send_visibility(3);
  EXPECT_EQ(taken(), 3000);
  send_scene(4000);
  send_visibility(4);
  EXPECT_EQ(taken(), 4000);
}

TEST_F(ColorTimesTest, OfWhatIsTakenInPartsAreOne) {
  send_scene(2000);
  send_visibility(2);
  send_scene(3000);
  EXPECT_EQ(taken(true), 3000);
  EXPECT_EQ(taken(true), 3000);
  EXPECT_EQ(taken(), 3000);
  EXPECT_EQ(taken(), 2000);
}

TEST_F(ColorTimesTest, AreNotKnownOfAnEngineWithoutAClock) {
  EXPECT_EQ(taken(), 0);
  send_scene(2000);
  EXPECT_EQ(taken(), 2000);
  send_visibility(2);
  send_scene(0);
  EXPECT_EQ(taken(), 0);
  EXPECT_EQ(taken(), 0);
}

TEST_F(ColorTimesTest, AreOfTheLastSceneBeforeWhereOneWasNotSeen) {
  send_scene(2000);
  ++server_.scene.version;  // it was lost
  send_scene(4000);
  EXPECT_EQ(taken(), 4000);
  send_visibility(3);
  EXPECT_EQ(taken(), 2000);
}

TEST_F(ColorTimesTest, OfAnEngineWhoseClockIsBehindAreNotTheOthers) {
  send_scene(5000);
  send_visibility(2);
  EXPECT_EQ(taken(), 5000);
  send_scene(1000);
  EXPECT_EQ(taken(), 1000);
  EXPECT_EQ(taken(), 1000) << "visibility is of the engine before";
  send_scene(2000);
  send_visibility(3);
  EXPECT_EQ(taken(), 2000);
  EXPECT_EQ(taken(), 1000);
}

}  // namespace
}  // namespace splatbus::stream

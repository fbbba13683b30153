// A bridge that leads, and another one that samples rounds for it.
#include <fmt/format.h>

#include "bridge_fixture.h"
#include "capture-bridge/round_helper.h"
#include "liveness.h"

namespace splatbus::capture_bridge::test {
namespace {

class BridgeSharingTest : public CaptureBridgeTest {
 protected:
  BridgeSharingTest() : other_(connect("capture-bridge-2")), helper_(other_, Device::Cpu, {}) {}

  void hear(bool with_helper) {
    std::vector<Node> nodes{{"engine", 1}};
    if (with_helper) {
      nodes.push_back({.name = "capture-bridge-2", .epoch = other_->epoch(), .kind = "capture-bridge"});
    }
    with_liveness(nodes, 0, [&](const wire::Liveness& liveness) { bridge_->take(liveness); });
  }
  bool until_helped(const std::function<bool()>& condition, std::chrono::milliseconds timeout = bus_test::patience) {
    return until(
        [&] {
          helper_.step(1ms);
          return condition();
        },
        timeout);
  }
  std::size_t rounds() { return received_["capture/input"].size(); }
  /// Another place has another round.
  void move_dome() { set("input_center", fmt::format("{},0.25,0", 0.1 * ++places_)); }

  std::shared_ptr<bus::Context> other_;
  RoundHelper helper_;
  int places_ = 0;
};

TEST_F(BridgeSharingTest, RoundsAreSampledInTurnsAndPublishedByTheOneThatLeads) {
  set("input_deadline_s", "60");
  start();
  hear(true);
  ASSERT_TRUE(until_helped([&] { return rounds() == 1 && bridge_->sharing().helpers() == 1; }));
  for (int k = 0; k < 6; ++k) {
    const std::size_t before = rounds();
    move_dome();
    ASSERT_TRUE(until_helped([&] { return rounds() == before + 1; }));
    EXPECT_EQ(last_input().cameras()->size(), 4U);
  }
  EXPECT_EQ(bridge_->sharing().handed(), 3U) << "of six, whoever had the first";
  EXPECT_EQ(bridge_->sharing().came_back(), 0U);
  EXPECT_EQ(helper_.counters().rounds, 3U);
  EXPECT_EQ(bridge_->input_statistics().rounds, rounds());
  for (const bus::Message& message : received_["capture/input"]) {
    EXPECT_EQ(message.header().source()->str(), "capture-bridge");
  }
}

TEST_F(BridgeSharingTest, ARoundOfAHelperThatDiesIsSampledHere) {
  set("input_deadline_s", "60");
  start();
  hear(true);
  ASSERT_TRUE(until_helped([&] { return rounds() == 1 && bridge_->sharing().helpers() == 1; }));
  std::size_t here = rounds();
  for (; bridge_->sharing().handed() == 0; here = rounds()) {
    move_dome();
    ASSERT_TRUE(until([&] { return rounds() > here || bridge_->sharing().handed() == 1; }));
  }
  EXPECT_FALSE(until([&] { return rounds() > here; }, 300ms));
  hear(false);
  ASSERT_TRUE(until([&] { return rounds() == here + 1; }));
  EXPECT_EQ(bridge_->sharing().came_back(), 1U);
  // It was only stuck: its answer is not waited for any more.
  hear(true);
  ASSERT_TRUE(until_helped([&] { return helper_.counters().rounds == 1; }));
  EXPECT_FALSE(until_helped([&] { return rounds() > here + 1; }, 300ms));
}

}  // namespace
}  // namespace splatbus::capture_bridge::test

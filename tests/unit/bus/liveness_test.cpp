#include "bus/liveness.h"

#include <gtest/gtest.h>

#include "bus_fixture.h"
#include "wire/system_generated.h"

namespace splatbus::bus_service {
namespace {

constexpr std::int64_t second = 1'000'000'000;

void beat(Liveness& liveness, std::int64_t now, wire::ServiceState state = wire::ServiceState::Running,
          std::uint64_t epoch = 1) {
  flatbuffers::FlatBufferBuilder builder;
  const auto header = wire::CreateHeaderDirect(builder, "Heartbeat/1", "trainer", 1, epoch);
  builder.Finish(wire::CreateHeartbeatDirect(builder, header, "trainer", 42, state));
  liveness.note(*flatbuffers::GetRoot<wire::Heartbeat>(builder.GetBufferPointer()), now);
}

TEST(LivenessTest, SilenceIsDeathAndAHeartbeatIsLife) {
  Liveness liveness;
  beat(liveness, 10 * second);
  EXPECT_TRUE(liveness.take_changed());
  EXPECT_TRUE(liveness.nodes().at("trainer").alive);
  beat(liveness, 11 * second);
  EXPECT_FALSE(liveness.take_changed());
  EXPECT_TRUE(liveness.update(13 * second).empty());
  EXPECT_TRUE(liveness.nodes().at("trainer").alive);
  EXPECT_TRUE(liveness.update(13 * second + 1).empty());
  EXPECT_FALSE(liveness.nodes().at("trainer").alive);
  EXPECT_TRUE(liveness.take_changed());
  beat(liveness, 14 * second, wire::ServiceState::Starting, 2);
  EXPECT_TRUE(liveness.nodes().at("trainer").alive);
  EXPECT_TRUE(liveness.take_changed());
}

TEST(LivenessTest, AStoppedServiceIsNotAlive) {
  Liveness liveness;
  beat(liveness, 10 * second);
  beat(liveness, 11 * second, wire::ServiceState::Stopping);
  EXPECT_FALSE(liveness.nodes().at("trainer").alive);
  EXPECT_TRUE(liveness.take_changed());
}

TEST(LivenessTest, TheLongGoneAreForgotten) {
  Liveness liveness;
  beat(liveness, 10 * second);
  EXPECT_EQ(liveness.update(71 * second), std::vector<std::string>{"trainer"});
  EXPECT_TRUE(liveness.nodes().empty());
}

}  // namespace
}  // namespace splatbus::bus_service

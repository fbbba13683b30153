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

TEST(LivenessTest, ANewSourceIsAChangeWhateverItSays) {
  for (const auto state : {wire::ServiceState::Starting, wire::ServiceState::Running, wire::ServiceState::Stopping}) {
    Liveness liveness;
    beat(liveness, 10 * second, state, 0);
    EXPECT_TRUE(liveness.take_changed()) << wire::EnumNameServiceState(state);
    EXPECT_FALSE(liveness.take_changed());
  }
}

TEST(LivenessTest, NodesAndTopicsAreBounded) {
  Liveness liveness;
  TopicTable table;
  for (int i = 0; i < 1100; ++i) {
    const std::string name = "source" + std::to_string(i);
    flatbuffers::FlatBufferBuilder builder;
    const auto header = wire::CreateHeaderDirect(builder, ("Schema/" + std::to_string(i)).c_str(), name.c_str(), 1, 1);
    builder.Finish(wire::CreateHeartbeatDirect(builder, header, "service"));
    const auto& heartbeat = *flatbuffers::GetRoot<wire::Heartbeat>(builder.GetBufferPointer());
    liveness.note(heartbeat, second);
    table.note("one", *heartbeat.header(), 10);
    table.note("topic" + std::to_string(i), *heartbeat.header(), 10);
  }
  EXPECT_EQ(liveness.nodes().size(), 1024u);
  EXPECT_EQ(table.topics().size(), 1024u);
  const auto& one = table.topics().find("one")->second;
  EXPECT_EQ(one.sources.size(), 16u);
  EXPECT_EQ(one.schemas.size(), 16u);
  EXPECT_EQ(one.messages, 1100u);
  EXPECT_EQ(one.bytes, 11000u);
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

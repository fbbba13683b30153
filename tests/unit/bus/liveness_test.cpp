#include "bus/liveness.h"

#include <gtest/gtest.h>

#include "../nanoseconds.h"
#include "bus_fixture.h"
#include "wire/system_generated.h"

namespace splatbus::bus_service {
namespace {

void beat(Liveness& liveness, std::int64_t now, wire::ServiceState state = wire::ServiceState::Running,
          std::uint64_t epoch = 1, const char* source = "trainer", std::uint32_t pid = 42) {
  flatbuffers::FlatBufferBuilder builder;
  const auto header = wire::CreateHeaderDirect(builder, "Heartbeat/1", source, 1, epoch);
  builder.Finish(wire::CreateHeartbeatDirect(builder, header, "trainer", pid, state));
  liveness.note(*flatbuffers::GetRoot<wire::Heartbeat>(builder.GetBufferPointer()), now);
}

TEST(LivenessTest, SilenceIsDeathAndAHeartbeatIsLife) {
  Liveness liveness;
  beat(liveness, 10 * kSecond);
  EXPECT_TRUE(liveness.take_changed());
  EXPECT_TRUE(liveness.nodes().at("trainer").alive);
  beat(liveness, 11 * kSecond);
  EXPECT_FALSE(liveness.take_changed());
  EXPECT_TRUE(liveness.update(13 * kSecond).empty());
  EXPECT_TRUE(liveness.nodes().at("trainer").alive);
  EXPECT_TRUE(liveness.update(13 * kSecond + 1).empty());
  EXPECT_FALSE(liveness.nodes().at("trainer").alive);
  EXPECT_TRUE(liveness.take_changed());
  beat(liveness, 14 * kSecond, wire::ServiceState::Starting, 2);
  EXPECT_TRUE(liveness.nodes().at("trainer").alive);
  EXPECT_TRUE(liveness.take_changed());
}

TEST(LivenessTest, ANewSourceIsAChangeWhateverItSays) {
  for (const auto state : {wire::ServiceState::Starting, wire::ServiceState::Running, wire::ServiceState::Stopping}) {
    Liveness liveness;
    beat(liveness, 10 * kSecond, state, 0);
    EXPECT_TRUE(liveness.take_changed()) << wire::EnumNameServiceState(state);
    EXPECT_FALSE(liveness.take_changed());
  }
}

TEST(LivenessTest, ASourceThatWasStartedAgainIsAChangeThoughItIsAsItWas) {
  Liveness liveness;
  beat(liveness, 10 * kSecond);
  EXPECT_TRUE(liveness.take_changed());
  beat(liveness, 11 * kSecond, wire::ServiceState::Running, 2);
  EXPECT_TRUE(liveness.take_changed());
  EXPECT_EQ(liveness.nodes().at("trainer").epoch, 2U);
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
    liveness.note(heartbeat, kSecond);
    table.note("one", *heartbeat.header(), 10, kSecond, true);
    table.note("topic" + std::to_string(i), *heartbeat.header(), 10, kSecond, true);
  }
  EXPECT_EQ(liveness.nodes().size(), 1024u);
  EXPECT_EQ(table.topics().size(), 1024u);
  const auto& one = table.topics().find("one")->second;
  EXPECT_EQ(one.sources.size(), 16u);
  EXPECT_EQ(one.schemas.size(), 16u);
  EXPECT_EQ(one.messages, 1100u);
  EXPECT_EQ(one.bytes, 11000u);
}

TEST(TopicTableTest, CountsTheMessagesOfEachSource) {
  TopicTable table;
  for (const char* source : {"streamer", "streamer-2", "streamer"}) {
    flatbuffers::FlatBufferBuilder builder;
    builder.Finish(wire::CreateHeaderDirect(builder, "StreamStats/2", source, 1, 1));
    table.note("stream/stats", *flatbuffers::GetRoot<wire::Header>(builder.GetBufferPointer()), 10, kSecond, true);
  }
  const auto& sources = table.topics().at("stream/stats").sources;
  EXPECT_EQ(sources.at("streamer"), 2u);
  EXPECT_EQ(sources.at("streamer-2"), 1u);
}

TEST(LivenessTest, WhoIsHereFindsAPlaceHoweverManyAreElsewhere) {
  Liveness liveness;
  const auto beat_as = [&](const std::string& name, bool local) {
    flatbuffers::FlatBufferBuilder builder;
    const auto header = wire::CreateHeaderDirect(builder, "Heartbeat/1", name.c_str(), 1, 1);
    builder.Finish(wire::CreateHeartbeatDirect(builder, header, "service"));
    liveness.note(*flatbuffers::GetRoot<wire::Heartbeat>(builder.GetBufferPointer()), kSecond, local);
  };
  for (int i = 0; i < 2000; ++i) beat_as("far" + std::to_string(i), false);
  EXPECT_EQ(liveness.nodes().size(), 512U);
  beat_as("trainer", true);
  EXPECT_TRUE(liveness.nodes().contains("trainer"));
  // One that moves here makes room there, and so do those that are forgotten.
  beat_as("far0", true);
  beat_as("late", false);
  EXPECT_TRUE(liveness.nodes().contains("late"));
  EXPECT_EQ(liveness.update(100 * kSecond).size(), 514U);
  for (int i = 0; i < 2000; ++i) beat_as("far" + std::to_string(i), false);
  EXPECT_EQ(liveness.nodes().size(), 512U);
}

TEST(TopicTableTest, TellsIntervalsAgesAndSharedMemoryApart) {
  TopicTable table;
  const auto note = [&](std::int64_t now, bool local) {
    flatbuffers::FlatBufferBuilder builder;
    const std::vector<std::uint32_t> shape{1000};
    const wire::Span shared(7, 2, 0, 1000, wire::Storage::Slab), carried(0, 0, 0, 50, wire::Storage::Inline);
    const std::vector<flatbuffers::Offset<wire::Tensor>> tensors{
        wire::CreateTensorDirect(builder, "shared", &shared, &shape),
        wire::CreateTensorDirect(builder, "carried", &carried, &shape)};
    builder.Finish(wire::CreateHeaderDirect(builder, "EngineFrame/3", "engine", 1, 1, now - 3 * kSecond, now - kSecond,
                                            0, false, nullptr, &tensors));
    table.note("topic", *flatbuffers::GetRoot<wire::Header>(builder.GetBufferPointer()), 10, now, local);
  };
  for (const std::int64_t at : {10, 11, 14}) note(at * kSecond, true);
  note(16 * kSecond, false);
  auto& topic = table.topics().at("topic");
  EXPECT_EQ(topic.bytes, 4 * 1060u);
  EXPECT_EQ(topic.shared_bytes, 4 * 1000u);
  const wire::Spread intervals = topic.intervals.take();  // 1, 3 and 2 s
  EXPECT_EQ(intervals.count(), 3u);
  EXPECT_DOUBLE_EQ(intervals.sum_s(), 6);
  EXPECT_DOUBLE_EQ(intervals.squares_s2(), 14);
  EXPECT_DOUBLE_EQ(intervals.least_s(), 1);
  EXPECT_DOUBLE_EQ(intervals.greatest_s(), 3);
  const wire::Spread transits = topic.transits.take();
  EXPECT_EQ(transits.count(), 3u) << "the clock of what came over tcp is another";
  EXPECT_DOUBLE_EQ(transits.sum_s(), 3);
  EXPECT_DOUBLE_EQ(topic.ages.take().sum_s(), 9);
  note(17 * kSecond, true);
  EXPECT_DOUBLE_EQ(topic.intervals.take().greatest_s(), 1) << "of the time since it was asked";
  EXPECT_EQ(topic.intervals.take().count(), 4u);
}

TEST(LivenessTest, AStoppedServiceIsNotAlive) {
  Liveness liveness;
  beat(liveness, 10 * kSecond);
  beat(liveness, 11 * kSecond, wire::ServiceState::Stopping);
  EXPECT_FALSE(liveness.nodes().at("trainer").alive);
  EXPECT_TRUE(liveness.take_changed());
}

TEST(LivenessTest, TheLongGoneAreForgotten) {
  Liveness liveness;
  beat(liveness, 10 * kSecond);
  EXPECT_EQ(liveness.update(71 * kSecond), std::vector<std::string>{"trainer"});
  EXPECT_TRUE(liveness.nodes().empty());
}

TEST(LivenessTest, AProcessThatGoesOnUnderAnotherNameIsThereOnce) {
  Liveness liveness;
  constexpr auto kRunning = wire::ServiceState::Running;
  beat(liveness, 10 * kSecond, kRunning, 2, "trainer.next", 43);
  beat(liveness, 10 * kSecond, kRunning, 1, "trainer", 42);
  beat(liveness, 13 * kSecond, kRunning, 1, "trainer", 42);
  EXPECT_TRUE(liveness.update(13 * kSecond).empty());
  EXPECT_EQ(liveness.nodes().size(), 2u) << "one that is silent beside another process may be heard of again";
  beat(liveness, 14 * kSecond, kRunning, 3, "trainer", 43);
  EXPECT_EQ(liveness.update(14 * kSecond), std::vector<std::string>{"trainer.next"});
  EXPECT_EQ(liveness.nodes().size(), 1u);
}

}  // namespace
}  // namespace splatbus::bus_service

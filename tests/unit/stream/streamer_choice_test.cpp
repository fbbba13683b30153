#include "stream/streamer_choice.h"

#include <gtest/gtest.h>

#include "../nanoseconds.h"
#include "wire/stream_generated.h"
#include "wire/system_generated.h"

namespace splatbus::stream {
namespace {

class StreamerChoiceTest : public testing::Test {
 protected:
  struct Said {
    std::uint32_t viewers = 0;
    float send_ms = 1;
    bool draining = false;
    std::vector<std::string> endpoints{};
  };
  void offer(const std::string& source) { offer(source, Said()); }
  void offer(const std::string& source, Said said) {
    if (said.endpoints.empty()) said.endpoints = {"ipc:///run/bus/" + source};
    flatbuffers::FlatBufferBuilder builder;
    const auto header = wire::CreateHeaderDirect(builder, "StreamerOffer/1", source.c_str());
    builder.Finish(wire::CreateStreamerOffer(builder, header, builder.CreateVectorOfStrings(said.endpoints),
                                             said.viewers, 64, 200, 10, said.send_ms, 0, said.draining));
    choice_.take(*flatbuffers::GetRoot<wire::StreamerOffer>(builder.GetBufferPointer()), now_ns_);
  }
  void liveness(const std::vector<std::pair<std::string, bool>>& nodes) {
    flatbuffers::FlatBufferBuilder builder;
    const auto header = wire::CreateHeaderDirect(builder, "Liveness/1", "bus");
    std::vector<flatbuffers::Offset<wire::Node>> all;
    for (const auto& [source, alive] : nodes) {
      all.push_back(
          wire::CreateNodeDirect(builder, source.c_str(), "streamer", 1, 1, wire::ServiceState::Running, alive));
    }
    builder.Finish(wire::CreateLivenessDirect(builder, header, &all));
    choice_.take(*flatbuffers::GetRoot<wire::Liveness>(builder.GetBufferPointer()), now_ns_);
  }
  std::string chosen() {
    const auto place = choice_.choose(now_ns_);
    return place ? place->source : "";
  }

  std::int64_t now_ns_ = 100 * kSecond;
  StreamerChoice choice_{true};
};

TEST_F(StreamerChoiceTest, TheNextViewerGoesWhereFewestAre) {
  EXPECT_EQ(chosen(), "");
  offer("a", {.viewers = 3});
  offer("b", {.viewers = 1});
  EXPECT_EQ(chosen(), "b");
  EXPECT_EQ(chosen(), "b");
  EXPECT_EQ(chosen(), "a") << "3 there, and 1 with 2 on their way";
  offer("b", {.viewers = 1});
  now_ns_ += 3 * kSecond;
  offer("a", {.viewers = 2});
  EXPECT_EQ(chosen(), "b") << "what was on its way has been counted";
}

TEST_F(StreamerChoiceTest, OneThatFillsItsTicksOrIsFullComesLast) {
  offer("a", {.viewers = 3, .send_ms = 170});
  offer("b", {.viewers = 20});
  EXPECT_EQ(chosen(), "b") << "a needs 180 of 200 ms";
  offer("a", {.viewers = 63});
  offer("b", {.viewers = 64});
  EXPECT_EQ(chosen(), "a");
}

TEST_F(StreamerChoiceTest, OneThatDrainsDiesOrIsSilentServesNobody) {
  offer("a");
  offer("b", {.viewers = 9});
  const StreamerPlace a{"a", "ipc:///run/bus/a"};
  EXPECT_TRUE(choice_.serves(a));
  EXPECT_FALSE(choice_.serves({"a", "ipc:///elsewhere"}));
  offer("a", {.draining = true});
  EXPECT_FALSE(choice_.serves(a));
  EXPECT_TRUE(choice_.others_serve("a"));
  EXPECT_FALSE(choice_.others_serve("b"));
  EXPECT_EQ(chosen(), "b");
  offer("a");
  liveness({{"a", false}, {"b", true}});
  EXPECT_EQ(chosen(), "b");
  offer("a");
  EXPECT_TRUE(choice_.serves(a)) << "it is back";
  for (int second = 0; second < 7; ++second) {
    now_ns_ += kSecond;
    offer("b");
    liveness({{"a", true}, {"b", true}});
  }
  EXPECT_FALSE(choice_.serves(a)) << "alive, and says nothing";
  EXPECT_EQ(choice_.serving(), 1U);
}

/// A bus that is away for a minute takes no streamer with it.
TEST_F(StreamerChoiceTest, NobodyIsTakenForGoneWhileTheBusIs) {
  offer("a");
  offer("b");
  liveness({{"a", true}, {"b", true}});
  now_ns_ += 60 * kSecond;
  EXPECT_EQ(choice_.serving(), 2U);
  liveness({});
  EXPECT_EQ(choice_.serving(), 2U) << "they speak again in a moment";
  now_ns_ += 2 * kSecond;
  liveness({});
  now_ns_ += 2 * kSecond;
  liveness({});
  now_ns_ += 2 * kSecond;
  liveness({});
  EXPECT_EQ(choice_.serving(), 0U);
}

TEST_F(StreamerChoiceTest, AViewerMovesToWhereFarFewerAre) {
  offer("a", {.viewers = 10});
  offer("b", {.viewers = 8});
  const StreamerPlace a{"a", "ipc:///run/bus/a"};
  EXPECT_EQ(choice_.better_than(a, now_ns_), std::nullopt) << "not worth it";
  offer("b", {.viewers = 2});
  int moved = 0;
  while (moved < 20 && choice_.better_than(a, now_ns_)) ++moved;
  EXPECT_EQ(moved, 5) << "until 7 are there, with those on their way";
  EXPECT_EQ(choice_.better_than({"b", "ipc:///run/bus/b"}, now_ns_), std::nullopt);
}

TEST_F(StreamerChoiceTest, FromAnotherMachineOnlyTcpIsWithinReach) {
  choice_ = StreamerChoice(false);
  offer("a");
  EXPECT_EQ(chosen(), "");
  offer("b", {.endpoints = {"ipc:///run/bus/b", "tcp://host:7600"}});
  EXPECT_EQ(choice_.choose(now_ns_), (StreamerPlace{"b", "tcp://host:7600"}));
}

TEST_F(StreamerChoiceTest, WhereNobodyCanConnectNobodyIsSentForAWhile) {
  offer("a", {.viewers = 0});
  offer("b", {.viewers = 5});
  liveness({{"a", true}, {"b", true}});
  const auto place = choice_.choose(now_ns_);
  ASSERT_EQ(place->source, "a");
  EXPECT_TRUE(choice_.pass_over(*place, now_ns_));
  EXPECT_FALSE(choice_.pass_over(*place, now_ns_)) << "it is known";
  EXPECT_FALSE(choice_.serves(*place));
  EXPECT_EQ(chosen(), "b");
  offer("a", {.viewers = 0});
  EXPECT_EQ(chosen(), "b") << "it says the same again";
  offer("a", {.viewers = 0, .endpoints = {"ipc:///run/bus/another"}});
  EXPECT_EQ(chosen(), "a");
  offer("a", {.viewers = 0});
  now_ns_ += StreamerChoice::kPassedOverNs + kSecond;
  offer("a", {.viewers = 0});
  offer("b", {.viewers = 5});
  liveness({{"a", true}, {"b", true}});
  EXPECT_EQ(chosen(), "a") << "perhaps there is a key now";
}

}  // namespace
}  // namespace splatbus::stream

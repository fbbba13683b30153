// Foxglove's protocol without sockets and without a bus.
#include "foxglove_hub_fixture.h"

namespace splatbus::gateway::foxglove {
namespace {

TEST_F(HubTest, AClientIsToldWhatThereIs) {
  hub_.offer(Hub::Kind::Bus, {offer("sys/log"), offer("engine/frame")});
  join(client_);
  const auto told = read(client_);
  ASSERT_EQ(told.size(), 2U);
  EXPECT_EQ(told[0]["op"], "serverInfo");
  EXPECT_EQ(told[0]["sessionId"], "session");
  ASSERT_EQ(told[1]["channels"].size(), 2U);
  const json& channel = told[1]["channels"][0];
  EXPECT_EQ(channel["topic"], "engine/frame");
  EXPECT_EQ(channel["encoding"], "flatbuffer");
  EXPECT_EQ(channel["schemaEncoding"], "flatbuffer");
  EXPECT_EQ(channel["schemaName"], "a.Table");
  EXPECT_EQ(channel["schema"], "AQID/w==");
}

TEST_F(HubTest, ChannelsComeAndGoUnderTheirOwnIds) {
  hub_.offer(Hub::Kind::Fixed, {offer("fixed")});
  join(client_);
  read(client_);
  hub_.offer(Hub::Kind::Cameras, {offer("a"), offer("b")});
  const auto added = read(client_);
  ASSERT_EQ(added.size(), 1U);
  const std::uint32_t a = added[0]["channels"][0]["id"], b = added[0]["channels"][1]["id"];
  subscribe(client_, 1, a);
  hub_.offer(Hub::Kind::Cameras, {offer("b")});
  EXPECT_EQ(read(client_), (std::vector<json>{{{"op", "unadvertise"}, {"channelIds", {a}}}}));
  EXPECT_THAT(*hub_.wanted(), IsEmpty()) << "its subscription has gone with it";
  hub_.offer(Hub::Kind::Cameras, {offer("b"), offer("a")});
  EXPECT_EQ(read(client_)[0]["channels"][0]["id"], a);
  hub_.offer(Hub::Kind::Cameras, {offer("a"), offer("b", "another.Table")});
  EXPECT_EQ(read(client_), (std::vector<json>{{{"op", "unadvertise"}, {"channelIds", {b}}}})) << "of another schema";
}

TEST_F(HubTest, DataGoesToThoseWhoAreSubscribedAndNothingElseIsWanted) {
  hub_.offer(Hub::Kind::Bus, {offer("a"), offer("b")});
  EXPECT_EQ(hub_.wanted(), std::nullopt) << "nobody is there";
  join(client_);
  join(other_);
  read(client_);
  read(other_);
  EXPECT_THAT(*hub_.wanted(), IsEmpty());
  subscribe(client_, 7, 1);
  const auto wanted = hub_.wanted();
  EXPECT_THAT(*wanted, ElementsAre(Pair("a", testing::_)));
  deliver("a", "hello");
  deliver("b", "nobody's");
  const auto got = read(client_);
  ASSERT_EQ(got.size(), 1U);
  EXPECT_EQ(got[0]["data"], "hello");
  EXPECT_EQ(got[0]["head"], json({1, 7, 0, 0, 0, 8, 7, 6, 5, 4, 3, 2, 1}));
  EXPECT_THAT(read(other_), IsEmpty());
  say(client_, {{"op", "unsubscribe"}, {"subscriptionIds", {7}}});
  EXPECT_THAT(*hub_.wanted(), IsEmpty());
  deliver("a", "again");
  EXPECT_THAT(read(client_), IsEmpty());
  subscribe(client_, 7, 1);
  EXPECT_NE(*hub_.wanted(), *wanted) << "what was held for it has to come again";
}

TEST_F(HubTest, WhoComesLaterGetsTheNewestOfEachKey) {
  hub_.offer(Hub::Kind::Bus, {offer("a")});
  join(client_);
  join(other_);
  subscribe(client_, 1, 1);
  deliver("a", "x1", "x");
  deliver("a", "y1", "y");
  deliver("a", "x2", "x");
  deliver("a", "not kept");
  read(other_);
  subscribe(other_, 1, 1);
  const auto got = read(other_);
  ASSERT_EQ(got.size(), 2U);
  EXPECT_EQ(got[0]["data"], "x2");
  EXPECT_EQ(got[1]["data"], "y1");
}

TEST_F(HubTest, OneThatDoesNotReadLosesTheOldestAndNoAnswers) {
  hub_.offer(Hub::Kind::Bus, {offer("a")});
  join(client_);
  read(client_);
  subscribe(client_, 1, 1);
  for (char i = 0; i < 20; ++i) deliver("a", std::string(87, static_cast<char>('a' + i)));  // 100 bytes each
  say(client_, {{"op", "getParameters"}, {"parameterNames", json::array()}, {"id", "q"}});
  EXPECT_LE(hub_.figures().queued_bytes, 1000U + 200U);
  EXPECT_EQ(hub_.figures().dropped, 10U);
  hub_.expire(2'000'000'000);
  const auto got = read(client_);
  ASSERT_EQ(got.size(), 12U);
  EXPECT_EQ(got[0]["id"], "q");
  EXPECT_EQ(got[1]["id"], "dropped");
  EXPECT_THAT(got[1]["message"], HasSubstr("10 messages"));
  EXPECT_EQ(got[2]["data"], std::string(87, 'a' + 10));
  EXPECT_TRUE(hub_.reads(client_.id));
  hub_.leave(client_.id);
  EXPECT_EQ(hub_.figures().dropped, 10U) << "the count stays";
}

TEST_F(HubTest, OneThatAsksAndNeverReadsIsFoundOut) {
  join(client_);
  for (int i = 0; i < 2000 && hub_.reads(client_.id); ++i) {
    say(client_, {{"op", "getParameters"}, {"parameterNames", json::array()}, {"id", "q"}});
  }
  EXPECT_FALSE(hub_.reads(client_.id));
}

TEST_F(HubTest, IsWokenOnceUntilAllIsTaken) {
  hub_.offer(Hub::Kind::Bus, {offer("a")});
  join(client_);
  EXPECT_EQ(client_.woken, 1);
  subscribe(client_, 1, 1);
  deliver("a", "1");
  EXPECT_EQ(client_.woken, 1);
  read(client_);
  deliver("a", "2");
  EXPECT_EQ(client_.woken, 2);
}

TEST_F(HubTest, RoomIsForSoMany) {
  Client clients[3];
  for (Client& one : clients) {
    EXPECT_TRUE(hub_.has_room());
    join(one);
  }
  EXPECT_FALSE(hub_.has_room());
  hub_.leave(clients[1].id);
  EXPECT_TRUE(hub_.has_room());
}

TEST_F(HubTest, WhatIsNoMessageIsMalformed) {
  join(client_);
  for (const std::string text :
       {"", "hello", "[]", "{}", R"({"op": 1})", R"({"op": "subscribe"})", R"({"op": "subscribe", "subscriptions": 1})",
        R"({"op": "subscribe", "subscriptions": [1]})",
        R"({"op": "subscribe", "subscriptions": [{"id": -1, "channelId": 1}]})",
        R"({"op": "subscribe", "subscriptions": [{"id": 4294967296, "channelId": 1}]})",
        R"({"op": "subscribe", "subscriptions": [{"id": 1.5, "channelId": 1}]})",
        R"({"op": "unsubscribe", "subscriptionIds": ["1"]})", R"({"op": "getParameters", "parameterNames": [[]]})",
        R"({"op": "setParameters", "parameters": [{"value": 1}]})", R"({"op": "setParameters", "parameters": [1]})",
        R"({"op": "fetchAsset", "uri": "x"})", R"({"op": "subscribe", "subscriptions": [}")"}) {
    EXPECT_EQ(say_text(client_, text), Hub::Reception::Malformed) << text;
  }
  EXPECT_EQ(say_text(client_, R"({"op": "x", "a": )" + std::string(100, '[') + std::string(100, ']') + "}"),
            Hub::Reception::Malformed);
  json many{{"op", "unsubscribe"}, {"subscriptionIds", std::vector<int>(5000, 1)}};
  EXPECT_EQ(say(client_, many), Hub::Reception::Malformed);
  for (const std::string& binary : {std::string(), std::string("\1\0\0\0", 4), std::string("\2\0\0\0\0", 5),
                                    std::string("\x09"
                                                "abcdefghijkl")}) {
    EXPECT_EQ(say_text(client_, binary, kControls, 0, true), Hub::Reception::Malformed);
  }
  EXPECT_THAT(read(client_, "status"), IsEmpty());
}

TEST_F(HubTest, WhatIsNotOfferedIsSaidSo) {
  join(client_);
  EXPECT_EQ(say(client_, {{"op", "advertise"}, {"channels", json::array()}}), Hub::Reception::Understood);
  EXPECT_EQ(say_text(client_, std::string("\1\0\0\0\0x", 6), kControls, 0, true), Hub::Reception::Understood);
  subscribe(client_, 1, 99);
  const auto said = read(client_, "status");
  ASSERT_EQ(said.size(), 3U);
  EXPECT_EQ(said[0]["level"], 2);
  EXPECT_THAT(said[2]["message"], HasSubstr("no channel 99"));
}

TEST_F(HubTest, AnAssetIsTheSessionsToAnswer) {
  join(client_);
  say(client_, {{"op", "fetchAsset"}, {"uri", "package://splatbus/model.glb"}, {"requestId", 5}});
  ASSERT_TRUE(asset_);
  EXPECT_EQ(asset_->id, 5U);
  EXPECT_EQ(asset_->uri, "package://splatbus/model.glb");
  read(client_);
  hub_.answer(client_.id, asset(5, std::make_shared<const std::string>("GLB"), ""));
  hub_.answer(client_.id, asset(6, nullptr, "no"));
  const auto got = read(client_);
  EXPECT_EQ(got[0]["head"], json({4, 5, 0, 0, 0, 0, 0, 0, 0, 0}));
  EXPECT_EQ(got[0]["data"], "GLB");
  EXPECT_EQ(got[1]["head"], json({4, 6, 0, 0, 0, 1, 2, 0, 0, 0, 'n', 'o'}));
}

TEST_F(HubTest, TheGraphNamesWhoPublishesAndWhoIsSubscribed) {
  hub_.offer(Hub::Kind::Cameras, {offer("a"), offer("b")});
  join(client_);
  subscribe(client_, 1, 1);
  say(client_, {{"op", "subscribeConnectionGraph"}});
  auto graph = read(client_, "connectionGraphUpdate");
  ASSERT_EQ(graph.size(), 1U);
  EXPECT_EQ(graph[0]["publishedTopics"][0], (json{{"name", "a"}, {"publisherIds", {"engine"}}}));
  EXPECT_EQ(graph[0]["subscribedTopics"][0]["subscriberIds"].size(), 1U);
  EXPECT_EQ(graph[0]["subscribedTopics"][1]["subscriberIds"].size(), 0U);
  hub_.offer(Hub::Kind::Cameras, {offer("a")});
  graph = read(client_, "connectionGraphUpdate");
  ASSERT_EQ(graph.size(), 1U);
  EXPECT_EQ(graph[0]["removedTopics"], json({"b"}));
}

}  // namespace
}  // namespace splatbus::gateway::foxglove

// Foxglove's protocol without sockets and without a bus.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "gateway/foxglove/hub.h"
#include "wire/system_generated.h"

namespace splatbus::gateway::foxglove {
namespace {

using nlohmann::json;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Pair;

constexpr bus::Rights kLooks{.view = true}, kControls{.view = true, .control = true};
const std::vector<std::uint8_t> kSchema{1, 2, 3, 255};

Offer offer(const std::string& topic, const std::string& schema = "a.Table") {
  return {.topic = topic, .schema_name = schema, .schema = kSchema, .publishers = {"engine"}};
}

class HubTest : public testing::Test {
 protected:
  struct Client {
    Hub::ClientId id = 0;
    int woken = 0;
  };
  Hub::Reception say(const Client& client, const json& message, const bus::Rights& rights = kControls,
                     std::int64_t now_ns = 0) {
    return say_text(client, message.dump(), rights, now_ns);
  }
  Hub::Reception say_text(const Client& client, const std::string& text, const bus::Rights& rights = kControls,
                          std::int64_t now_ns = 0, bool binary = false) {
    return hub_.receive(client.id, {reinterpret_cast<const std::uint8_t*>(text.data()), text.size()}, binary, rights,
                        now_ns, asset_);
  }
  /// To a bus with nobody on it.
  void join(Client& client) {
    client.id = hub_.join([&client] { ++client.woken; });
    hub_.listed({}, 0);
  }
  /// All that waits for it: texts as JSON, binary ones as {"data": payload, "head": bytes}.
  std::vector<json> read(const Client& client) {
    std::vector<json> all;
    while (const auto message = hub_.take(client.id)) {
      if (!message->binary) {
        all.push_back(json::parse(message->head));
      } else {
        all.push_back({{"head", std::vector<std::uint8_t>(message->head.begin(), message->head.end())},
                       {"data", message->payload ? *message->payload : ""}});
      }
    }
    return all;
  }
  /// Those of them with that `op`.
  std::vector<json> read(const Client& client, const std::string& operation) {
    std::vector<json> all = read(client);
    std::erase_if(all, [&](const json& one) { return one.value("op", "") != operation; });
    return all;
  }
  void subscribe(const Client& client, std::uint32_t subscription, std::uint32_t channel) {
    say(client, {{"op", "subscribe"}, {"subscriptions", {{{"id", subscription}, {"channelId", channel}}}}});
  }
  void deliver(const std::string& topic, const std::string& text, const std::optional<std::string>& keep = {}) {
    hub_.deliver(topic, 0x0102030405060708, std::make_shared<const std::string>(text), keep);
  }

  Hub hub_{3, 1000, "session"};
  Client client_, other_;
  std::optional<Hub::AssetRequest> asset_;
};

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

/// A client that has heard of a trainer's parameters.
class HubParameters : public HubTest {
 protected:
  HubParameters() {
    hub_.on_set(
        [this](const std::string& source, const NamedValues& changes) { asked_.emplace_back(source, changes); });
    join(client_);
    hub_.heard("trainer", values_, 0);
    read(client_);
  }
  void ask(const Client& client, const std::vector<std::string>& names = {}, std::int64_t now_ns = 0) {
    say(client, {{"op", "getParameters"}, {"parameterNames", names}, {"id", "g"}}, kControls, now_ns);
  }
  Hub::Reception set(const json& value, const std::string& key = "rate", const bus::Rights& rights = kControls) {
    return say(client_,
               {{"op", "setParameters"}, {"id", "s"}, {"parameters", {{{"name", "trainer/" + key}, {"value", value}}}}},
               rights);
  }
  NamedParameters values_{{"rate", "0.25"}, {"paused", "false"}, {"views", "4"}, {"mode", "fast"}};
  std::vector<std::pair<std::string, NamedValues>> asked_;
};

TEST_F(HubParameters, AreOfTheTypeThatIsDeclared) {
  using wire::ValueType;
  hub_.heard("engine",
             {{"night", "true", ValueType::Text},
              {"lamps", "4", ValueType::Integer},
              {"name", "7", ValueType::Choice},
              {"scale", "2", ValueType::Number},
              {"shown", "true", ValueType::Boolean}},
             0);
  ask(client_, {"engine/night", "engine/lamps", "engine/name", "engine/scale", "engine/shown"});
  EXPECT_EQ(read(client_, "parameterValues")[0]["parameters"],
            json({{{"name", "engine/night"}, {"value", "true"}},
                  {{"name", "engine/lamps"}, {"value", 4}},
                  {{"name", "engine/name"}, {"value", "7"}},
                  {{"name", "engine/scale"}, {"value", 2.0}, {"type", "float64"}},
                  {{"name", "engine/shown"}, {"value", true}}}));
}

TEST_F(HubParameters, OfNoDeclaredTypeAreTypedByWhatTheyReadLike) {
  say(client_, {{"op", "getParameters"}, {"parameterNames", json::array()}, {"id", "g"}});
  const auto got = read(client_, "parameterValues");
  ASSERT_EQ(got.size(), 1U);
  EXPECT_EQ(got[0]["id"], "g");
  EXPECT_EQ(got[0]["parameters"], json({{{"name", "trainer/mode"}, {"value", "fast"}},
                                        {{"name", "trainer/paused"}, {"value", false}},
                                        {{"name", "trainer/rate"}, {"value", 0.25}, {"type", "float64"}},
                                        {{"name", "trainer/views"}, {"value", 4}}}));
  say(client_, {{"op", "getParameters"}, {"parameterNames", {"trainer/mode", "none"}}});
  EXPECT_EQ(read(client_)[0]["parameters"].size(), 1U);
}

TEST_F(HubParameters, ASettingIsAnsweredWhenTheServiceSaysIt) {
  EXPECT_EQ(set(0.5), Hub::Reception::Understood);
  EXPECT_THAT(asked_, ElementsAre(Pair("trainer", ElementsAre(Pair("rate", "0.5")))));
  EXPECT_THAT(read(client_), IsEmpty());
  hub_.heard("trainer", values_, 0);
  EXPECT_THAT(read(client_), IsEmpty()) << "a heartbeat from before";
  values_[0].value = "0.500000001";  // a float's
  hub_.heard("trainer", values_, 0);
  const auto got = read(client_);
  ASSERT_EQ(got.size(), 1U);
  EXPECT_EQ(got[0]["id"], "s");
  EXPECT_NEAR(got[0]["parameters"][0]["value"].get<double>(), 0.5, 1e-6);
}

TEST_F(HubParameters, OneThatIsRefusedIsAnsweredWithTheReason) {
  set(99);
  hub_.logged_error("expander", "parameter 'rate': '99' is not from 0 to 1");
  hub_.logged_error("trainer", "something else");
  EXPECT_THAT(read(client_), IsEmpty());
  hub_.logged_error("trainer", "parameter 'rate': '99' is not from 0 to 1");
  const auto got = read(client_);
  ASSERT_EQ(got.size(), 2U);
  EXPECT_EQ(got[0]["op"], "status");
  EXPECT_EQ(got[0]["level"], 2);
  EXPECT_THAT(got[0]["message"], HasSubstr("'99' is not from 0 to 1"));
  EXPECT_EQ(got[1]["parameters"][0]["value"], 0.25) << "as it still is";
}

TEST_F(HubParameters, ASilentServiceIsSaidToBe) {
  set(0.5);
  hub_.expire(4'000'000'000);
  EXPECT_THAT(read(client_), IsEmpty());
  hub_.expire(6'000'000'000);
  const auto got = read(client_);
  ASSERT_EQ(got.size(), 2U);
  EXPECT_EQ(got[0]["level"], 1);
  EXPECT_EQ(got[1]["id"], "s");
}

TEST_F(HubParameters, OnlyWhoMayControlSetsThem) {
  EXPECT_EQ(set(0.5, "rate", kLooks), Hub::Reception::Forbidden);
  EXPECT_THAT(asked_, IsEmpty());
  EXPECT_THAT(read(client_, "status")[0]["message"], HasSubstr("right to control"));
}

TEST_F(HubParameters, NamesAndTypesThatThereAreNotAreRefused) {
  set(1, "none");
  set(json({1, 2}));
  set(nullptr);
  EXPECT_THAT(asked_, IsEmpty());
  EXPECT_EQ(read(client_, "status").size(), 3U);
}

TEST_F(HubParameters, ChangesAreToldToThoseWhoAskedForThem) {
  join(other_);
  read(other_);
  say(client_, {{"op", "subscribeParameterUpdates"}, {"parameterNames", {"trainer/rate"}}});
  say(other_, {{"op", "subscribeParameterUpdates"}, {"parameterNames", json::array()}});
  values_[0].value = "0.3";
  values_[3].value = "slow";
  hub_.heard("trainer", values_, 0);
  EXPECT_EQ(read(client_)[0]["parameters"].size(), 1U);
  EXPECT_EQ(read(other_)[0]["parameters"].size(), 2U);
  hub_.heard("trainer", values_, 0);
  EXPECT_THAT(read(other_), IsEmpty());
  say(client_, {{"op", "unsubscribeParameterUpdates"}, {"parameterNames", {"trainer/rate"}}});
  values_[0].value = "0.4";
  hub_.heard("trainer", values_, 0);
  EXPECT_THAT(read(client_), IsEmpty());
}

// Foxglove asks once, as soon as it is connected.
TEST_F(HubParameters, AQuestionWaitsUntilAllWhoAreThereHaveSpoken) {
  hub_.forget();
  ask(client_);
  EXPECT_THAT(read(client_), IsEmpty());
  hub_.heard("trainer", {{"rate", "0.25"}}, 0);
  EXPECT_THAT(read(client_), IsEmpty()) << "who else is there is not known yet";
  hub_.listed({{"trainer", true}, {"relight", true}, {"viewer", false}}, 0);
  EXPECT_THAT(read(client_), IsEmpty());
  hub_.heard("relight", {{"softness_m", "0.1"}}, 0);
  const auto got = read(client_);
  ASSERT_EQ(got.size(), 1U);
  EXPECT_EQ(got[0]["id"], "g");
  EXPECT_EQ(got[0]["parameters"].size(), 2U);
  hub_.listed({{"trainer", true}, {"relight", true}, {"new", true}}, 0);
  ask(client_);
  EXPECT_EQ(read(client_).size(), 1U) << "whoever comes later is told of by updates";
}

TEST_F(HubParameters, AQuestionIsAnsweredWhoeverKeepsSilent) {
  hub_.forget();
  ask(client_, {}, 1'000'000'000);
  hub_.heard("trainer", values_, 1'000'000'000);
  hub_.listed({{"trainer", true}, {"silent", true}}, 1'000'000'000);
  hub_.expire(2'900'000'000);
  EXPECT_THAT(read(client_), IsEmpty());
  hub_.expire(3'000'000'000);
  const auto got = read(client_);
  ASSERT_EQ(got.size(), 1U);
  EXPECT_EQ(got[0]["parameters"].size(), values_.size());
}

TEST_F(HubParameters, ThoseOfAServiceThatHasEndedAreTakenOff) {
  say(client_, {{"op", "subscribeParameterUpdates"}, {"parameterNames", json::array()}});
  hub_.heard("streamer-2", {{"join_kbps", "50"}}, 0);
  hub_.listed({{"trainer", true}, {"streamer-2", true}}, 0);
  read(client_);
  set(0.5);
  hub_.listed({{"trainer", true}, {"streamer-2", false}}, 0);
  auto got = read(client_);
  ASSERT_EQ(got.size(), 1U);
  EXPECT_EQ(got[0]["parameters"], json::parse(R"([{"name": "streamer-2/join_kbps"}])")) << "without a value";
  ask(client_, {"streamer-2/join_kbps"});
  EXPECT_THAT(read(client_)[0]["parameters"], IsEmpty());
  say(client_, {{"op", "setParameters"}, {"parameters", {{{"name", "streamer-2/join_kbps"}, {"value", 1}}}}});
  EXPECT_THAT(read(client_, "status")[0]["message"], HasSubstr("no parameter"));
  hub_.listed({{"trainer", false}}, 0);
  got = read(client_);
  ASSERT_EQ(got.size(), 3U);
  EXPECT_THAT(got[0]["message"], HasSubstr("trainer/rate': its service has ended")) << "what had been asked of it";
  EXPECT_EQ(got[1]["id"], "s");
}

TEST_F(HubParameters, ThoseOfWhoIsNotListedStayForAsLongAsABrokerNeedsToHearAll) {
  hub_.heard("trainer", values_, 5'000'000'000);
  hub_.listed({}, 8'000'000'000);
  ask(client_);
  EXPECT_EQ(read(client_)[0]["parameters"].size(), values_.size());
  hub_.listed({}, 8'000'000'001);
  ask(client_);
  EXPECT_THAT(read(client_)[0]["parameters"], IsEmpty());
}

TEST_F(HubParameters, WhatAServiceNoLongerHasIsTakenOff) {
  values_.pop_back();
  hub_.heard("trainer", values_, 0);
  ask(client_, {"trainer/mode"});
  EXPECT_THAT(read(client_)[0]["parameters"], IsEmpty());
}

}  // namespace
}  // namespace splatbus::gateway::foxglove

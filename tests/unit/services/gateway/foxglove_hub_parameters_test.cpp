// Foxglove's parameters without sockets and without a bus.
#include "foxglove_hub_fixture.h"

namespace splatbus::gateway::foxglove {
namespace {

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

TEST(ParameterBoard, WhenItIsFullItKeepsWhatItHas) {
  ParameterBoard board;
  NamedParameters many;
  for (int k = 0; k < 256; ++k) many.push_back({std::to_string(k), "1"});
  const auto source = [](int k) { return "service-" + std::to_string(k); };
  for (int k = 0; k < 64; ++k) EXPECT_EQ(board.update(source(k), many, 0).size(), 256U);
  EXPECT_THAT(board.update("one too many", many, 0), IsEmpty());
  for (int k = 0; k < 64; ++k) EXPECT_THAT(board.update(source(k), many, 0), IsEmpty());
  many.front().value = "2";
  EXPECT_EQ(board.update(source(0), many, 0).size(), 1U);
}

}  // namespace
}  // namespace splatbus::gateway::foxglove

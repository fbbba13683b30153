#include "schema_json.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <filesystem>
#include <limits>
#include <optional>

#include "bus/broker.h"
#include "bus/publisher.h"
#include "topic_statistics.h"
#include "wire/system_generated.h"
#include "wire/viewer_generated.h"

namespace splatbus::cli {
namespace {

using namespace std::chrono_literals;
using Json = nlohmann::json;

class SchemaJsonTest : public testing::Test {
 protected:
  SchemaJsonTest() {
    std::string path = (std::filesystem::temp_directory_path() / "splatbus-json-XXXXXX").string();
    folder_ = mkdtemp(path.data());
    broker_.emplace(bus_service::BrokerOptions{.address = bus::Address::parse("ipc://" + folder_)});
    broker_->start();
    context_ = bus::Context::create(broker_->address(), "tester");
    publisher_.emplace(context_);
    subscriber_.emplace(context_, std::vector<std::string>{"test/*"});
  }
  ~SchemaJsonTest() override {
    publisher_.reset();
    subscriber_.reset();
    context_.reset();
    broker_.reset();
    std::filesystem::remove_all(folder_);
  }

  /// Latched, so that it comes whenever the subscription does.
  template <class Table, class Build>
  bus::Message round_trip(Build build, std::string_view schema = kSchema<Table>, const bus::MessageInfo& info = {}) {
    publisher_->publish(Topic<Table>{"test/topic", topics::kLatched, schema}, info, build);
    auto message = subscriber_->receive(60s);
    EXPECT_TRUE(message.has_value());
    return std::move(*message);
  }

  std::string folder_;
  std::optional<bus_service::Broker> broker_;
  std::shared_ptr<bus::Context> context_;
  std::optional<bus::Publisher> publisher_;
  std::optional<bus::Subscriber> subscriber_;
  SchemaJson json_;
};

TEST_F(SchemaJsonTest, EveryFieldUnderItsName) {
  const bus::Message message = round_trip<wire::Heartbeat>([](auto& builder, auto header) {
    const std::vector counters{wire::CreateCounterDirect(builder, "frames", 42.5)};
    const std::vector parameters{wire::CreateKeyValueDirect(builder, "inf", "a \"quoted\" nan")};
    return wire::CreateHeartbeatDirect(builder, header, "fake", 7, wire::ServiceState::Running, "d\xc3\xa9tail",
                                       &counters, &parameters);
  });
  const Json json = json_.to_json(message);
  EXPECT_EQ(json["header"]["schema"], "Heartbeat/1");
  EXPECT_EQ(json["header"]["source"], "tester");
  EXPECT_EQ(json["service"], "fake");
  EXPECT_EQ(json["pid"], 7);
  EXPECT_EQ(json["state"], "Running");
  EXPECT_EQ(json["detail"], "d\xc3\xa9tail");
  EXPECT_EQ(json["counters"][0]["value"], 42.5);
  EXPECT_EQ(json["parameters"][0]["key"], "inf");
  EXPECT_EQ(json["parameters"][0]["value"], "a \"quoted\" nan");
}

TEST_F(SchemaJsonTest, NumbersThatJsonLacksBecomeNull) {
  const float inf = std::numeric_limits<float>::infinity();
  const bus::Message message = round_trip<wire::ViewerQuality>([&](auto& builder, auto header) {
    return wire::CreateViewerQualityDirect(builder, header, "inf nan", 1, -inf, std::numeric_limits<float>::quiet_NaN(),
                                           0.5F);
  });
  const Json json = json_.to_json(message);
  EXPECT_EQ(json["viewer"], "inf nan");
  EXPECT_TRUE(json["psnr_db"].is_null());
  EXPECT_TRUE(json["ssim"].is_null());
  EXPECT_EQ(json["flip"], 0.5);
}

TEST_F(SchemaJsonTest, TensorsAreSummarised) {
  const std::array<float, 6> values{1, -2.5F, 3, 0, 8, 4};
  const std::array<std::uint16_t, 3> halves{0x3C00, 0xC000, 0x0001};  // 1, -2, 2^-24
  bus::MessageInfo info;
  info.tensors = {
      {.name = "values", .shape = {2, 3}, .type = bus::ElementType::F32, .inline_data = values.data()},
      {.name = "halves", .shape = {3}, .type = bus::ElementType::F16, .inline_data = halves.data()},
      {.name = "none", .shape = {0}, .type = bus::ElementType::U8, .inline_data = values.data()},
  };
  const auto log = [](auto& builder, auto header) {
    return wire::CreateLogDirect(builder, header, wire::LogLevel::Info, "text");
  };
  const bus::Message message = round_trip<wire::Log>(log, kSchema<wire::Log>, info);
  const Json tensors = json_.to_json(message)["header"]["tensors"];
  ASSERT_EQ(tensors.size(), 3U);
  EXPECT_EQ(tensors[0], Json({{"name", "values"}, {"shape", {2, 3}}, {"type", "F32"}, {"min", -2.5}, {"max", 8.0}}));
  EXPECT_EQ(tensors[1]["min"], -2.0);
  EXPECT_EQ(tensors[1]["max"], 1.0);
  EXPECT_TRUE(tensors[2]["min"].is_null());
}

TEST_F(SchemaJsonTest, UnknownAndWrongSchemasAreRefused) {
  const auto error_of = [&](const bus::Message& message) -> std::string {
    try {
      static_cast<void>(json_.to_json(message));
    } catch (const bus::Error& error) {
      return error.what();
    }
    return "no error";
  };
  const auto log = [](auto& builder, auto header) {
    return wire::CreateLogDirect(builder, header, wire::LogLevel::Info, "text");
  };
  EXPECT_EQ(error_of(round_trip<wire::Log>(log, "Nonsense/1")), "test/topic: unknown schema 'Nonsense/1'");
  EXPECT_EQ(error_of(round_trip<wire::Log>(log, "Vec3/1")), "test/topic: unknown schema 'Vec3/1'");
  EXPECT_EQ(error_of(round_trip<wire::Log>(log, "EngineFrame/1")), "test/topic: unknown schema 'EngineFrame/1'")
      << "a version that this program does not have";
  EXPECT_EQ(error_of(round_trip<wire::Log>(log, kSchema<wire::EngineFrame>)), "test/topic: not a valid EngineFrame/3");
}

TEST(TopicStatistics, TrafficIsWhatCameBetweenTwoSnapshots) {
  TopicSnapshot before{.published_ns = 5'000'000'000, .topics = {}};
  before.topics["a"] = {.schemas = {"Log/1"}, .sources = {"x"}, .latched = false, .messages = 10, .bytes = 1000};
  TopicSnapshot after = before;
  after.published_ns += 2'000'000'000;
  after.topics["a"].messages = 16;
  after.topics["a"].bytes = 251'000;
  after.topics["b"].messages = 4;
  EXPECT_EQ(traffic_between(before, after, "a").messages, 6U);
  EXPECT_DOUBLE_EQ(traffic_between(before, after, "a").rate_hz, 3);
  EXPECT_DOUBLE_EQ(traffic_between(before, after, "a").megabits_per_s, 1);
  EXPECT_DOUBLE_EQ(traffic_between(before, after, "b").rate_hz, 2);
  EXPECT_EQ(traffic_between(before, after, "c").messages, 0U);
  EXPECT_EQ(traffic_between(after, after, "a").rate_hz, 0) << "no time has passed";
  after.topics["a"].messages = 3;
  EXPECT_EQ(traffic_between(before, after, "a").messages, 0U) << "another broker";
}

TEST(TopicStatistics, EachSourceHasItsOwnRateWhoeverElsePublishes) {
  TopicSnapshot before{.published_ns = 5'000'000'000, .topics = {}};
  before.topics["stream/stats"] = {.sources = {"streamer", "streamer-2"},
                                   .messages = 300,
                                   .source_messages = {{"streamer", 200}, {"streamer-2", 100}}};
  before.topics["alone"] = {.sources = {"streamer-2"}, .messages = 10, .source_messages = {{"streamer-2", 10}}};
  TopicSnapshot after = before;
  after.published_ns += 2'000'000'000;
  after.topics["stream/stats"].messages += 30;
  after.topics["stream/stats"].source_messages = {{"streamer", 220}, {"streamer-2", 106}, {"streamer-3", 4}};
  after.topics["alone"].messages += 2;
  after.topics["alone"].source_messages["streamer-2"] += 2;
  EXPECT_EQ(source_rates(before, after),
            (std::map<std::string, double>{{"streamer", 10}, {"streamer-2", 4}, {"streamer-3", 2}}));
  EXPECT_TRUE(source_rates(after, after).empty()) << "no time has passed";
  for (auto* snapshot : {&before, &after}) {
    for (auto& [name, topic] : snapshot->topics) topic.source_messages.clear();
  }
  EXPECT_EQ(source_rates(before, after), (std::map<std::string, double>{{"streamer-2", 1}}))
      << "an older broker tells it where there is one source";
}

TEST(JsonText, BytesThatAreNotUtf8AreReplaced) {
  const nlohmann::json json{{"topic\xff", {"sour\xc3", "d\xc3\xa9j\xc3\xa0"}}};
  EXPECT_EQ(json_text(json), "{\"topic\xef\xbf\xbd\":[\"sour\xef\xbf\xbd\",\"d\xc3\xa9j\xc3\xa0\"]}");
  EXPECT_FALSE(nlohmann::json::parse(json_text(json, 2), nullptr, false).is_discarded());
}

TEST(JsonText, OneLineUnlessIndented) {
  const nlohmann::json json{{"a", 1}, {"b", nullptr}};
  EXPECT_EQ(json_text(json), R"({"a":1,"b":null})");
  EXPECT_EQ(json_text(json, 2), "{\n  \"a\": 1,\n  \"b\": null\n}");
}

}  // namespace
}  // namespace splatbus::cli

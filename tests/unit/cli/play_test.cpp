// What each option of `play` means, for a recording whose times are made up here.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <future>

#include "../bus/bus_fixture.h"
#include "../nanoseconds.h"
#include "mcap/writer.h"
#include "player.h"
#include "recorded_pace.h"
#include "recording_file.h"
#include "wire/model_generated.h"
#include "wire/scene_generated.h"
#include "wire/system_generated.h"

namespace splatbus::cli {
namespace {

using bus_test::eventually;
using bus_test::patience;

constexpr std::int64_t kMonotonicNs = 5'000 * kSecond;      // of the machine that recorded, when it began
constexpr std::int64_t kUtcNs = 1'700'000'000 * kSecond;    // the same moment
constexpr std::int64_t kStep = 100 * kSecond;               // from one message to the next
constexpr std::int64_t kAgeNs = 30'000'000;                 // of a frame when its message was published
constexpr std::uint64_t kVersion = 4'000'000'000'123;       // of the first scene
constexpr std::uint64_t kDepthVersion = 4'000'000'000'045;  // of the sun, from the second message on
constexpr std::uint64_t kMessages = 5;

/// scene/state of engine frame `number`.
std::vector<std::byte> scene_update(std::uint64_t number) {
  flatbuffers::FlatBufferBuilder builder;
  const std::int64_t publish_ns = kMonotonicNs + static_cast<std::int64_t>(number) * kStep;
  const auto header =
      wire::CreateHeaderDirect(builder, "SceneUpdate/1", "bridge", number + 1, 77, publish_ns - kAgeNs, publish_ns);
  const std::vector<float> ambient(27);
  const auto light = wire::CreateLightDirect(builder, 0, &ambient, nullptr, nullptr, nullptr, nullptr,
                                             number == 0 ? 0 : kDepthVersion);
  builder.Finish(wire::CreateSceneUpdate(builder, header,
                                         wire::CreateSceneState(builder, number, 0.5, 0, light, kVersion + number)));
  const auto* const bytes = reinterpret_cast<const std::byte*>(builder.GetBufferPointer());
  return {bytes, bytes + builder.GetSize()};
}

class PlayTest : public bus_test::BusTest {
 protected:
  PlayTest() {
    mcap::Writer writer(mcap::create_file(path()), {});
    writer.write(mcap::Metadata{.name = kRecordingMetadata,
                                .values = {{"realtime_minus_monotonic_ns", std::to_string(kUtcNs - kMonotonicNs)}}});
    const auto channel = writer.add_channel(0, "scene/state", "flatbuffer", {});
    for (std::uint64_t i = 0; i < kMessages; ++i) {
      const auto data = scene_update(i);
      writer.write(mcap::Message{.channel_id = channel,
                                 .log_time = static_cast<std::uint64_t>(kUtcNs) + i * kStep,
                                 .publish_time = static_cast<std::uint64_t>(kUtcNs) + i * kStep,
                                 .data = data});
    }
    writer.close();
  }
  [[nodiscard]] std::string path() const { return directory_.path() + "/made-up.mcap"; }

  struct Heard {
    std::string topic;
    std::uint64_t frame, version, depth_version;
    std::int64_t publish_ns, capture_ns;
  };
  /// What a reader of both topics hears of it.
  std::vector<Heard> play(const PlayOptions& options) {
    bus::Subscriber reader(connect("reader"), {"scene/state", "elsewhere"});
    EXPECT_TRUE(reader.wait_connected(patience));
    begin_ns_ = bus::now_ns();
    auto played = std::async(std::launch::async, [&] {
      mcap::Reader file(path());
      return Player(file, directory_.address(), options).run({}, [](const PlayState&) {});
    });
    std::vector<Heard> heard;
    std::optional<std::uint64_t> expected;
    EXPECT_TRUE(eventually([&] {
      if (!expected && played.wait_for(std::chrono::seconds(0)) == std::future_status::ready) {
        expected = played.get().messages;
      }
      if (const auto message = reader.receive(std::chrono::milliseconds(1))) {
        const auto& scene = *message->root<wire::SceneUpdate>().scene();
        heard.push_back({message->topic(), scene.frame(), scene.version(), scene.light()->sun_depth_version(),
                         message->header().publish_ns(), message->header().capture_ns()});
      }
      return expected && heard.size() >= *expected;
    }));
    end_ns_ = bus::now_ns();
    return heard;
  }

  std::int64_t begin_ns_ = 0, end_ns_ = 0;
};

// As recorded it would take 400 s, which no test may.
TEST_F(PlayTest, TheRateDividesTimeAndNothingIsEarly) {
  const auto heard = play({.rate = 10'000, .topics = {"*"}});
  ASSERT_EQ(heard.size(), kMessages);
  for (std::size_t i = 0; i < heard.size(); ++i) {
    EXPECT_EQ(heard[i].frame, i);
    EXPECT_GE(heard[i].publish_ns, begin_ns_ + static_cast<std::int64_t>(i) * kStep / 10'000);
  }
}

TEST_F(PlayTest, APartBeginsAndEndsWhereItIsAskedTo) {
  const auto heard = play({.rate = 10'000, .start_s = 150, .duration_s = 200, .topics = {"*"}});
  ASSERT_EQ(heard.size(), 2U);
  EXPECT_EQ(heard[0].frame, 2U);
  EXPECT_EQ(heard[1].frame, 3U);
  EXPECT_GE(heard[0].publish_ns, begin_ns_ + 50 * kSecond / 10'000) << "time begins at 150 s, not with a message";
  EXPECT_GE(heard[1].publish_ns, begin_ns_ + 150 * kSecond / 10'000);
}

TEST_F(PlayTest, ARemappedTopicIsUnderItsNewNameAlone) {
  const auto heard = play({.rate = 100'000, .topics = {"scene/state"}, .remap = {{"scene/state", "elsewhere"}}});
  ASSERT_EQ(heard.size(), kMessages);
  for (const Heard& one : heard) EXPECT_EQ(one.topic, "elsewhere");
}

TEST_F(PlayTest, TheRecordedClockLeavesTimesAndVersionsAsTheyWere) {
  const auto heard = play({.rate = 100'000, .topics = {"*"}, .recorded_clock = true});
  ASSERT_EQ(heard.size(), kMessages);
  for (std::size_t i = 0; i < heard.size(); ++i) {
    const std::int64_t published_ns = kMonotonicNs + static_cast<std::int64_t>(i) * kStep;
    EXPECT_EQ(heard[i].publish_ns, published_ns);
    EXPECT_EQ(heard[i].capture_ns, published_ns - kAgeNs);
    EXPECT_EQ(heard[i].version, kVersion + i);
    EXPECT_EQ(heard[i].depth_version, i == 0 ? 0 : kDepthVersion);
  }
}

TEST_F(PlayTest, ThisMachinesClockKeepsAgesAndMovesVersionsByOneShift) {
  const auto heard = play({.rate = 100'000, .topics = {"*"}});
  ASSERT_EQ(heard.size(), kMessages);
  const std::uint64_t shift = heard[0].version - kVersion;
  // By as much as this machine's clock is ahead of the recorded one when playing begins.
  EXPECT_GE(static_cast<std::int64_t>(shift), begin_ns_ - kMonotonicNs);
  EXPECT_LE(static_cast<std::int64_t>(shift), end_ns_ - kMonotonicNs);
  for (std::size_t i = 0; i < heard.size(); ++i) {
    EXPECT_GE(heard[i].publish_ns, begin_ns_);
    EXPECT_LE(heard[i].publish_ns, end_ns_);
    EXPECT_EQ(heard[i].publish_ns - heard[i].capture_ns, kAgeNs);
    EXPECT_EQ(heard[i].version, kVersion + i + shift);
    EXPECT_EQ(heard[i].depth_version, i == 0 ? 0 : kDepthVersion + shift) << "0 says that there is none";
  }
}

TEST(RecordedPaceTest, StepsAreSpreadEvenlyBetweenTwoMoments) {
  const RecordedPace pace(std::vector<PaceMoment>{
      {.log_time = 1000, .step = 2}, {.log_time = 2000, .step = 12}, {.log_time = 3000, .step = 12}});
  const std::vector<std::pair<std::uint64_t, std::uint64_t>> expected{{0, 0},     {999, 0},   {1000, 2}, {1500, 7},
                                                                      {2000, 12}, {2500, 12}, {9000, 12}};
  for (const auto& [log_time, step] : expected) EXPECT_EQ(pace.step_at(log_time), step) << log_time;
  EXPECT_TRUE(RecordedPace(std::vector<PaceMoment>{}).empty());
}

/// Says the steps of a trainer that is at once as far as it may go, and the parameters of an expander.
class TrainerInStead {
 public:
  explicit TrainerInStead(const std::shared_ptr<bus::Context>& context) : publisher_(context), subscriber_(context) {
    subscriber_.on(topics::control("control/trainer"), [this](const wire::Control& control, const bus::Message&) {
      for (const wire::KeyValue* change : *control.changes()) {
        if (change->key()->string_view() == "run_until") step_ = std::stoull(change->value()->str());
      }
    });
    EXPECT_TRUE(subscriber_.wait_connected(patience));
  }
  void speak() {
    subscriber_.dispatch_all(std::chrono::milliseconds(1));
    publisher_.publish(topics::kTrainerStats,
                       [&](auto& builder, auto header) { return wire::CreateTrainerStats(builder, header, step_); });
    publisher_.publish(topics::kHeartbeat, [&](auto& builder, auto header) {
      const std::vector parameters{wire::CreateKeyValueDirect(builder, "fill_distance", "1"),
                                   wire::CreateKeyValueDirect(builder, "fill_steps_per_s", "0")};
      return wire::CreateHeartbeatDirect(builder, header, "expander", 0, wire::ServiceState::Running, nullptr, nullptr,
                                         &parameters);
    });
  }
  [[nodiscard]] std::uint64_t step() const { return step_; }

 private:
  bus::Publisher publisher_;
  bus::Subscriber subscriber_;
  std::uint64_t step_ = 0;
};

// The recorder hears of the trainer for longer than of the engine.
TEST_F(PlayTest, ATrainerTakesTheStepsThatWereRecordedAfterTheLastThingPlayed) {
  TrainerInStead trainer(connect("trainer"));
  PaceKeeper pace(connect("pace"), RecordedPace(std::vector<PaceMoment>{{.log_time = 1 * kSecond, .step = 2},
                                                                        {.log_time = 11 * kSecond, .step = 102}}));
  auto playing = std::async(std::launch::async, [&] {
    pace.hold(1 * kSecond, {});
    pace.hold(6 * kSecond, {});
    pace.finish({});
  });
  EXPECT_TRUE(eventually([&] {
    trainer.speak();
    return playing.wait_for(std::chrono::seconds(0)) == std::future_status::ready;
  }));
  EXPECT_EQ(trainer.step(), 102U);
  EXPECT_EQ(pace.given_up(), 0U);
}

}  // namespace
}  // namespace splatbus::cli

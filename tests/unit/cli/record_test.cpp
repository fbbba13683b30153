#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <future>

#include "../bus/fake_broker.h"
#include "../bus/slab_helpers.h"
#include "record_fixture.h"
#include "wire/scene_generated.h"

namespace splatbus::cli {
namespace {

using bus_test::eventually;
using bus_test::number_of;
using bus_test::patience;
using bus_test::publish_number;
using namespace std::chrono_literals;

TEST_F(RecordTest, WhatWasRecordedIsPlayedWithItsPayloads) {
  const auto engine = connect("engine");
  bus_test::NumberPublisher pictures(engine, "pictures"), light(engine, "light");
  const auto slab = engine->create_slab("ring", 4, 1024);
  publish_number(light, 1, true, "sun", {bus_test::write_floats(*slab, {0.5F})});
  const auto recorder = record();
  poll_until(*recorder, "light", 1);
  for (std::uint64_t i = 0; i < 20; ++i) {
    publish_number(pictures, i, false, "", {bus_test::write_floats(*slab, {static_cast<float>(i), 2, 3})});
    poll_until(*recorder, "pictures", i + 1);
  }
  recorder->finish();
  EXPECT_EQ(recorder->state().total().dropped(), 0U);

  OtherBus other;
  bus::Subscriber reader(other.connect("reader"), {"pictures", "lamp"});
  ASSERT_TRUE(reader.wait_connected(patience));
  const std::int64_t before_ns = bus::now_ns();
  auto played = std::async(std::launch::async, [&] {
    return other.play(path(), {.rate = 1000, .topics = {"pictures", "light"}, .remap = {{"light", "lamp"}}});
  });
  std::uint64_t next = 0;
  bool lit = false;
  ASSERT_TRUE(eventually([&] {
    const auto message = reader.receive(10ms);
    if (!message) return false;
    const wire::Header& header = message->header();
    EXPECT_EQ(header.source()->str(), "engine");
    EXPECT_NE(header.epoch(), engine->epoch());
    EXPECT_GE(header.publish_ns(), before_ns);
    if (message->topic() == "lamp") {
      EXPECT_TRUE(header.latch());
      EXPECT_EQ(header.latch_key()->str(), "sun");
      EXPECT_EQ(floats_of(*message), std::vector<float>{0.5F});
      lit = true;
      return false;
    }
    EXPECT_EQ(header.sequence(), next + 1);
    EXPECT_EQ(number_of(*message), next);
    EXPECT_NE(message->tensor("values")->slab(), nullptr) << "as from the engine: in a slab";
    EXPECT_EQ(floats_of(*message), (std::vector<float>{static_cast<float>(next), 2, 3}));
    return ++next == 20;
  }));
  EXPECT_TRUE(lit);
  EXPECT_EQ(played.get().messages, 21U);
  EXPECT_EQ(reader.lost(), 0U);
}

TEST_F(RecordTest, PlayingFromTheMiddleBeginsWithWhatWasLatched) {
  const auto engine = connect("engine");
  bus_test::NumberPublisher numbers(engine, "numbers"), light(engine, "light");
  const auto recorder = record();
  for (std::uint64_t i = 0; i < 6; ++i) {
    if (i < 3) publish_number(light, 100 + i, true, i == 0 ? "moon" : "sun");
    publish_number(numbers, i);
    poll_until(*recorder, "numbers", i + 1);
    std::this_thread::sleep_for(20ms);  // recorded time has to pass
  }
  recorder->finish();

  mcap::Reader file(path());
  std::vector<std::uint64_t> times;
  for (std::size_t chunk = 0; chunk < file.summary().chunks.size(); ++chunk) {
    file.read_chunk(chunk, [&](const mcap::Message& message) {
      if (file.summary().channels.at(message.channel_id).topic == "numbers") times.push_back(message.log_time);
    });
  }
  ASSERT_EQ(times.size(), 6U);
  const double start_s = static_cast<double>(times[4] - file.summary().statistics.message_start_time) / 1e9 - 0.001;

  OtherBus other;
  bus::Subscriber reader(other.connect("reader"), {"numbers", "light"});
  ASSERT_TRUE(reader.wait_connected(patience));
  const PlayState state = other.play(path(), {.start_s = start_s, .topics = {"numbers", "light"}});
  EXPECT_EQ(state.messages, 4U);
  std::vector<std::uint64_t> heard;
  ASSERT_TRUE(eventually([&] {
    if (const auto message = reader.receive(10ms)) heard.push_back(number_of(*message));
    return heard.size() == 4;
  }));
  EXPECT_EQ(heard, (std::vector<std::uint64_t>{100, 102, 4, 5}));
}

TEST_F(RecordTest, EachLoopIsAnEpochOfItsOwnWithLaterSceneVersions) {
  const auto bridge = connect("capture-bridge");
  const bus::Publisher publisher(bridge);
  const auto recorder = record();
  for (std::uint64_t i = 1; i <= 2; ++i) {
    publisher.publish(topics::kSceneState, {.capture_ns = bus::now_ns()}, [&](auto& builder, auto header) {
      const auto light = wire::CreateLight(builder, 0, builder.CreateVector(std::vector<float>(27)));
      return wire::CreateSceneUpdate(builder, header,
                                     wire::CreateSceneState(builder, i, 0.5, 0, light, bridge->epoch() + i));
    });
    poll_until(*recorder, "scene/state", i);  // before the broker is there, a latched message replaces the one before
  }
  recorder->finish();

  OtherBus other;
  bus::Subscriber reader(other.connect("reader"), {"scene/state"});
  ASSERT_TRUE(reader.wait_connected(patience));
  std::stop_source stop;
  auto played = std::async(std::launch::async, [&] {
    mcap::Reader file(path());
    Player player(file, other.connect("unused")->address(), {.loop = true, .topics = {"scene/*"}});
    return player.run(stop.get_token(), [](const PlayState&) {});
  });
  std::vector<std::uint64_t> versions, epochs;
  EXPECT_TRUE(eventually([&] {
    if (const auto message = reader.receive(10ms)) {
      versions.push_back(message->root<wire::SceneUpdate>().scene()->version());
      epochs.push_back(message->header().epoch());
    }
    return versions.size() >= 5;
  }));
  stop.request_stop();
  EXPECT_GE(played.get().loops, 2U);
  EXPECT_TRUE(std::ranges::is_sorted(versions));
  EXPECT_EQ(std::ranges::adjacent_find(versions), versions.end()) << "a version is never used twice";
  EXPECT_GT(versions[0], bridge->epoch() + 2);
  EXPECT_EQ(versions[1], versions[0] + 1);
  EXPECT_EQ(epochs[0], epochs[1]);
  EXPECT_GT(epochs[2], epochs[1]);
}

TEST_F(RecordTest, PayloadsThatWereNotAskedForAreNotRecordedNorPlayed) {
  const auto engine = connect("engine");
  bus_test::NumberPublisher pictures(engine, "pictures");
  const auto slab = engine->create_slab("ring", 4, 1 << 20);
  RecorderOptions options;
  options.payloads.clear();
  const auto recorder = record(options);
  publish_number(pictures, 1, false, "", {bus_test::write_floats(*slab, std::vector<float>(100'000, 1.5F))});
  poll_until(*recorder, "pictures", 1);
  recorder->finish();
  EXPECT_LT(recorder->state().topics.at("pictures").bytes, 1000U);
  const PlayState state = OtherBus().play(path(), {.topics = {"pictures"}});
  EXPECT_EQ(state.messages, 0U);
  EXPECT_EQ(state.without_tensors, 1U);
}

TEST_F(RecordTest, ATensorThatIsGoneIsCounted) {
  const auto engine = connect("engine");
  bus_test::NumberPublisher pictures(engine, "pictures");
  const auto slab = engine->create_slab("ring", 1, 1024);
  const auto recorder = record();
  const auto old = bus_test::write_floats(*slab, {1});
  const auto newer = bus_test::write_floats(*slab, {2});
  publish_number(pictures, 1, false, "", {old});
  publish_number(pictures, 2, false, "", {newer});
  poll_until(*recorder, "pictures", 2);
  recorder->finish();
  EXPECT_EQ(recorder->state().topics.at("pictures").overwritten, 1U);
  EXPECT_EQ(recorder->state().topics.at("pictures").messages, 1U);
}

TEST_F(RecordTest, OfANumberedRowAsManyAreLostAsAreMissing) {
  const auto recorder = record();
  bus_test::RawPublisher raw(directory_.address().publish_endpoint());
  for (const std::uint64_t sequence : {3U, 4U, 6U, 7U, 11U}) {
    raw.send({"numbers", bus_test::probe_body(sequence, sequence)});
  }
  poll_until(*recorder, "numbers", 9);
  recorder->finish();
  EXPECT_EQ(recorder->state().topics.at("numbers").messages, 5U);
  EXPECT_EQ(recorder->state().topics.at("numbers").lost, 4U) << "5, 8, 9, 10; of those before the first nobody knows";
}

TEST_F(RecordTest, SourcesThatSpeakForThemselvesAreNotPlayed) {
  bus_test::NumberPublisher a(connect("a"), "numbers"), b(connect("b"), "numbers");
  const auto recorder = record();
  publish_number(a, 1);
  publish_number(b, 2);
  poll_until(*recorder, "numbers", 2);
  recorder->finish();
  const PlayState of_b = OtherBus().play(path(), {.topics = {"numbers"}, .silent = {"a"}});
  EXPECT_EQ(of_b.sources, (std::map<std::string, std::uint64_t>{{"b", 1}}));
  const PlayState of_a = OtherBus().play(path(), {.topics = {"numbers"}, .sources = {"a"}});
  EXPECT_EQ(of_a.sources, (std::map<std::string, std::uint64_t>{{"a", 1}}));
}

}  // namespace
}  // namespace splatbus::cli

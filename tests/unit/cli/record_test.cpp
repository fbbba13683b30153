#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <filesystem>
#include <future>

#include "../bus/bus_fixture.h"
#include "../bus/slab_helpers.h"
#include "mcap/reader.h"
#include "player.h"
#include "recorder.h"
#include "wire/scene_generated.h"

namespace splatbus::cli {
namespace {

using bus_test::eventually;
using bus_test::number_of;
using bus_test::patience;
using bus_test::publish_number;
using namespace std::chrono_literals;

RecordingFileOptions to_file(const std::filesystem::path& path) {
  RecordingFileOptions options;
  options.metadata = {{.name = kRecordingMetadata,
                       .values = {{"realtime_minus_monotonic_ns", std::to_string(realtime_minus_monotonic_ns())}}}};
  options.open = [path](unsigned part) {
    return mcap::create_file(part == 0 ? path.string() : path.string() + std::to_string(part));
  };
  return options;
}

class RecordTest : public bus_test::BusTest {
 protected:
  [[nodiscard]] std::filesystem::path path() const { return std::filesystem::path(directory_.path()) / "test.mcap"; }

  std::unique_ptr<Recorder> record(RecorderOptions options = {}) {
    if (!options.file.open) options.file = to_file(path());
    auto recorder = std::make_unique<Recorder>(connect("recorder"), options);
    EXPECT_TRUE(recorder->wait_connected(patience));
    return recorder;
  }
  /// Until `topic` has that many messages, dropped ones counted.
  static void poll_until(Recorder& recorder, const std::string& topic, std::uint64_t count) {
    ASSERT_TRUE(eventually([&] {
      recorder.poll(1ms);
      const auto topics = recorder.state().topics;
      const auto found = topics.find(topic);
      return found != topics.end() && found->second.messages + found->second.dropped() >= count;
    }));
  }
};

/// Another bus, on which a recording is played.
class OtherBus {
 public:
  OtherBus() { broker_.start(); }
  std::shared_ptr<bus::Context> connect(const std::string& source) {
    return bus::Context::create(directory_.address(), source);
  }
  PlayState play(const std::filesystem::path& path, const PlayOptions& options) {
    mcap::Reader reader(path);
    Player player(reader, directory_.address(), options);
    return player.run({}, [](const PlayState&) {});
  }

 private:
  bus_test::TemporaryDirectory directory_;
  bus_service::Broker broker_{bus_service::BrokerOptions{.address = directory_.address()}};
};

std::vector<float> floats_of(const bus::Message& message) {
  const auto tensor = message.tensor("values");
  if (!tensor) return {};
  std::vector<float> values(tensor->elements());
  return tensor->copy(values.data()) ? values : std::vector<float>();
}

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

/// A disk that takes nothing until it is let.
class SlowDisk : public mcap::Output {
 public:
  SlowDisk(std::shared_future<void> open, const std::filesystem::path& path)
      : open_(std::move(open)), file_(mcap::create_file(path)) {}
  void write(std::span<const std::byte> bytes) override {
    if (bytes.size() > 4096) open_.wait();
    file_->write(bytes);
  }

 private:
  std::shared_future<void> open_;
  std::unique_ptr<mcap::Output> file_;
};

TEST_F(RecordTest, ASlowDiskCostsMessagesAndNoMemory) {
  std::promise<void> open;
  RecorderOptions options;
  options.queue_bytes = 1 << 20;
  options.file = to_file(path());
  options.file.writer.chunk_bytes = 64 << 10;
  options.file.open = [&, gate = open.get_future().share()](unsigned) {
    return std::make_unique<SlowDisk>(gate, path());
  };
  const auto engine = connect("engine");
  bus_test::NumberPublisher pictures(engine, "pictures"), light(engine, "light");
  const auto slab = engine->create_slab("ring", 4, 128 << 10);
  const auto recorder = record(options);
  std::vector<float> noise(32 << 10);
  for (std::uint64_t i = 0; i < 40; ++i) {
    for (std::size_t k = 0; k < noise.size(); ++k) noise[k] = static_cast<float>((k * 2654435761U + i) % 99991);
    publish_number(pictures, i, false, "", {bus_test::write_floats(*slab, noise)});
    poll_until(*recorder, "pictures", i + 1);
    EXPECT_LE(recorder->state().queued_bytes, options.queue_bytes);
  }
  publish_number(light, 1, true);
  poll_until(*recorder, "light", 1);
  const Recorder::State state = recorder->state();
  const TopicRecord& record = state.topics.at("pictures");
  EXPECT_LE(state.most_queued_bytes, options.queue_bytes);
  // 7 of 128 KiB with a little each have room below the last eighth, one is on its way to the disk.
  EXPECT_EQ(record.messages + record.slow_disk, 40U);
  EXPECT_GE(record.messages, 6U);
  EXPECT_LE(record.messages, 8U);
  EXPECT_EQ(state.topics.at("light").messages, 1U) << "there is room left for what is latched";
  open.set_value();
  recorder->finish();

  mcap::Reader reader(path());
  EXPECT_EQ(reader.damage(), "");
  std::string said;
  for (const auto& metadata : reader.read_metadata()) {
    if (metadata.name == kDropsMetadata) said = metadata.values.at("pictures");
  }
  EXPECT_EQ(said, std::to_string(record.slow_disk) + " (slow disk " + std::to_string(record.slow_disk) + ")");
}

/// A disk that is full after so many bytes.
class FullDisk : public mcap::Output {
 public:
  FullDisk(std::uint64_t room, const std::filesystem::path& path) : room_(room), file_(mcap::create_file(path)) {}
  void write(std::span<const std::byte> bytes) override {
    file_->write(bytes.first(std::min<std::uint64_t>(bytes.size(), room_)));
    if (bytes.size() > room_) throw mcap::Error("test.mcap: No space left on device");
    room_ -= bytes.size();
  }

 private:
  std::uint64_t room_;
  std::unique_ptr<mcap::Output> file_;
};

TEST_F(RecordTest, AFullDiskEndsTheRecordingAndWhatIsCountedAsWrittenCanBeRead) {
  for (const bool split : {false, true}) {
    std::filesystem::remove(path());
    RecorderOptions options;
    options.file = to_file(path());
    options.file.writer.chunk_bytes = 2000;
    options.file.writer.compression_level = 0;
    options.file.max_bytes = split ? 15'000 : 0;
    options.file.split = split;
    // With parts it is full when the first is completed.
    options.file.open = [&](unsigned) { return std::make_unique<FullDisk>(split ? 17'000 : 30'000, path()); };
    bus_test::NumberPublisher numbers(connect(split ? "b" : "a"), "numbers");
    const auto recorder = record(options);
    std::uint64_t published = 0;
    while (recorder->state().failure.empty()) {
      publish_number(numbers, published++);
      poll_until(*recorder, "numbers", published);
      ASSERT_LT(published, 20'000U);
    }
    EXPECT_THROW(recorder->finish(), mcap::Error);
    const TopicRecord record = recorder->state().topics.at("numbers");
    EXPECT_EQ(record.messages + record.failed_disk, published);
    EXPECT_GT(record.failed_disk, 0U);
    EXPECT_EQ(recorder->state().queued_bytes, 0U);
    const mcap::Reader reader(path());
    EXPECT_NE(reader.damage(), "");
    EXPECT_GE(reader.summary().statistics.message_count, record.messages) << "more may have reached the disk";
  }
}

TEST_F(RecordTest, EachPartOfASplitRecordingStandsAlone) {
  RecorderOptions options;
  options.file = to_file(path());
  options.file.split = true;
  options.file.max_bytes = 30'000;
  options.file.writer.chunk_bytes = 1000;
  const auto engine = connect("engine");
  bus_test::NumberPublisher numbers(engine, "numbers"), light(engine, "light");
  const auto recorder = record(options);
  publish_number(light, 7, true, "sun");
  std::uint64_t published = 0;
  while (recorder->state().parts < 3) {
    publish_number(numbers, published++);
    poll_until(*recorder, "numbers", published);
    ASSERT_LT(published, 20'000U);
  }
  recorder->finish();
  ASSERT_EQ(recorder->state().total().dropped(), 0U);
  std::uint64_t read = 0;
  for (unsigned i = 0; i < recorder->state().parts; ++i) {
    const std::string part = i == 0 ? path().string() : path().string() + std::to_string(i);
    mcap::Reader reader(part);
    EXPECT_EQ(reader.damage(), "");
    std::vector<std::string> topics;
    for (std::size_t chunk = 0; chunk < reader.summary().chunks.size(); ++chunk) {
      reader.read_chunk(chunk, [&](const mcap::Message& message) {
        topics.push_back(reader.summary().channels.at(message.channel_id).topic);
      });
    }
    EXPECT_TRUE(std::ranges::count(topics, "light") == 1) << part;
    read += static_cast<std::uint64_t>(std::ranges::count(topics, "numbers"));
  }
  EXPECT_EQ(read, published);
}

TEST_F(RecordTest, ARecorderThatDiesLeavesWhatItHadWritten) {
  RecorderOptions options;
  options.file = to_file(path());
  options.file.writer.chunk_bytes = 2000;
  const auto engine = connect("engine");
  bus_test::NumberPublisher numbers(engine, "numbers");
  {
    const auto recorder = record(options);
    for (std::uint64_t i = 0; i < 100; ++i) {
      publish_number(numbers, i);
      poll_until(*recorder, "numbers", i + 1);
    }
    ASSERT_TRUE(eventually([&] { return recorder->state().queued_bytes == 0; }));
  }
  const mcap::Reader reader(path());
  EXPECT_NE(reader.damage(), "");
  const PlayState state = OtherBus().play(path(), {.rate = 1000, .topics = {"numbers"}});
  EXPECT_GE(state.messages, 80U);
  EXPECT_LE(state.messages, 100U);
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

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <atomic>
#include <filesystem>
#include <future>

#include "../bus/slab_helpers.h"
#include "record_fixture.h"
#include "verbs.h"

namespace splatbus::cli {
namespace {

using bus_test::eventually;
using bus_test::publish_number;

/// What a recording is worth when its disk is slow or full, or its file is split or never completed.
class RecordDiskTest : public RecordTest {
 protected:
  RecorderOptions in_parts() {
    RecorderOptions options;
    options.file = to_file(path());
    options.file.split = true;
    options.file.max_bytes = 30'000;
    options.file.writer.chunk_bytes = 1000;
    return options;
  }
};

/// A disk that takes nothing until it is let.
class SlowDisk : public mcap::Output {
 public:
  SlowDisk(std::shared_future<void> open, const std::filesystem::path& path, std::atomic<bool>* waits = nullptr)
      : open_(std::move(open)), waits_(waits), file_(mcap::create_file(path)) {}
  void write(std::span<const std::byte> bytes) override {
    if (bytes.size() > 4096) {
      if (waits_ != nullptr) *waits_ = true;
      open_.wait();
    }
    file_->write(bytes);
  }

 private:
  std::shared_future<void> open_;
  std::atomic<bool>* waits_;
  std::unique_ptr<mcap::Output> file_;
};

TEST_F(RecordDiskTest, ASlowDiskCostsMessagesAndNoMemory) {
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

TEST_F(RecordDiskTest, WhatIsLatchedFindsRoomWhereNothingElseDoes) {
  std::promise<void> open;
  std::atomic<bool> disk_waits = false;
  RecorderOptions options;
  options.topics = {"numbers", "light"};
  options.queue_bytes = 64 << 10;
  options.file = to_file(path());
  options.file.writer.chunk_bytes = 8 << 10;
  options.file.writer.compression_level = 0;
  options.file.open = [&, gate = open.get_future().share()](unsigned) {
    return std::make_unique<SlowDisk>(gate, path(), &disk_waits);
  };
  const auto engine = connect("engine");
  bus_test::NumberPublisher numbers(engine, "numbers"), light(engine, "light");
  const auto slab = engine->create_slab("ring", 4, 8 << 10);
  const auto recorder = record(options);
  std::uint64_t published = 0;
  const auto publish_until = [&](const auto& condition) {
    while (!condition()) {
      publish_number(numbers, published++);
      poll_until(*recorder, "numbers", published);
      ASSERT_LT(published, 20'000U);
    }
  };
  publish_until([&] { return disk_waits.load(); });  // from here on the queue only grows
  const std::uint64_t before = recorder->state().topics.at("numbers").slow_disk;
  publish_until([&] { return recorder->state().topics.at("numbers").slow_disk > before; });
  // Less than the last eighth, and more than one of the numbers.
  publish_number(light, 1, true, "", {bus_test::write_floats(*slab, std::vector<float>(1500))});
  poll_until(*recorder, "light", 1);
  EXPECT_EQ(recorder->state().topics.at("light").messages, 1U);
  EXPECT_LE(recorder->state().most_queued_bytes, options.queue_bytes);
  open.set_value();
  recorder->finish();
}

/// What a file says is missing, by topic.
mcap::StringMap missing_of(const std::filesystem::path& path) {
  for (const auto& metadata : mcap::Reader(path).read_metadata()) {
    if (metadata.name == kDropsMetadata) return metadata.values;
  }
  return {{"no", kDropsMetadata}};
}

TEST_F(RecordDiskTest, WhatWaitsWhenTheFileIsFullIsCountedAndNotAsRecorded) {
  std::promise<void> open;
  RecorderOptions options;
  options.file = to_file(path());
  options.file.writer.chunk_bytes = 10'000;
  options.file.writer.compression_level = 0;
  options.file.max_bytes = 60'000;
  options.topics = {"numbers"};
  options.file.open = [&, gate = open.get_future().share()](unsigned) {
    return std::make_unique<SlowDisk>(gate, path());
  };
  constexpr std::uint64_t kPublished = 1000;
  bus_test::NumberPublisher numbers(connect("engine"), "numbers");
  const auto recorder = record(options);
  for (std::uint64_t i = 0; i < kPublished; ++i) {
    publish_number(numbers, i);
    poll_until(*recorder, "numbers", i + 1);
  }
  open.set_value();
  recorder->finish();
  const Recorder::State state = recorder->state();
  const TopicRecord& record = state.topics.at("numbers");
  EXPECT_TRUE(state.full);
  EXPECT_GT(record.messages, 0U);
  EXPECT_GT(record.beyond_limit, 0U);
  EXPECT_EQ(record.messages + record.beyond_limit, kPublished);
  const mcap::Reader reader(path());
  EXPECT_EQ(reader.damage(), "");
  std::uint64_t written = 0, bytes = 0;
  for (const auto& [id, channel] : reader.summary().channels) {
    if (channel.topic == "numbers") written += reader.summary().statistics.channel_message_counts.at(id);
  }
  for (std::size_t chunk = 0; chunk < reader.summary().chunks.size(); ++chunk) {
    mcap::Reader(path()).read_chunk(chunk, [&](const mcap::Message& message) {
      if (reader.summary().channels.at(message.channel_id).topic == "numbers") bytes += message.data.size();
    });
  }
  EXPECT_EQ(record.messages, written);
  EXPECT_EQ(record.bytes, bytes);
  const std::string count = std::to_string(record.beyond_limit);
  EXPECT_EQ(missing_of(path()).at("numbers"), count + " (beyond the limit " + count + ")");
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

TEST_F(RecordDiskTest, AFullDiskEndsTheRecordingAndWhatIsCountedAsWrittenCanBeRead) {
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

TEST_F(RecordDiskTest, EachPartOfASplitRecordingStandsAlone) {
  const RecorderOptions options = in_parts();
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
  std::uint64_t read = 0, end = 0;
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
    EXPECT_GE(reader.summary().statistics.message_start_time, end) << part << " has times of the one before it";
    end = reader.summary().statistics.message_end_time;
    read += static_cast<std::uint64_t>(std::ranges::count(topics, "numbers"));
  }
  EXPECT_EQ(read, published);
}

TEST_F(RecordDiskTest, EachPartSaysWhatIsMissingOfIt) {
  const RecorderOptions options = in_parts();
  const auto engine = connect("engine");
  bus_test::NumberPublisher numbers(engine, "numbers"), pictures(engine, "pictures");
  const auto slab = engine->create_slab("ring", 1, 1024);
  const auto recorder = record(options);
  std::uint64_t published = 0, gone = 0;
  // Of the first part one is missing, of the second two, of the third none.
  for (unsigned part = 0; part < 3; ++part) {
    for (unsigned i = 0; i < (part + 1) % 3; ++i) {
      const auto old = bus_test::write_floats(*slab, {1});
      const auto newer = bus_test::write_floats(*slab, {2});
      publish_number(pictures, 1, false, "", {old});
      poll_until(*recorder, "pictures", ++gone);
    }
    while (recorder->state().parts == part + 1) {
      publish_number(numbers, published++);
      poll_until(*recorder, "numbers", published);
      ASSERT_LT(published, 40'000U);
    }
    ASSERT_TRUE(eventually([&] { return recorder->state().queued_bytes == 0; }));
  }
  recorder->finish();
  EXPECT_EQ(recorder->state().topics.at("pictures").overwritten, 3U);
  const auto of_part = [&](unsigned part) {
    return missing_of(path().string() + (part == 0 ? "" : std::to_string(part)));
  };
  EXPECT_EQ(of_part(0), (mcap::StringMap{{"pictures", "1 (overwritten 1)"}}));
  EXPECT_EQ(of_part(1), (mcap::StringMap{{"pictures", "2 (overwritten 2)"}}));
  EXPECT_EQ(of_part(2), mcap::StringMap());
  EXPECT_EQ(of_part(3), mcap::StringMap());
}

TEST(RecordVerb, PartsNeedASize) {
  const auto parse = [](std::vector<std::string> arguments) {
    CLI::App app;
    Action action;
    add_record_verb(app, action);
    std::ranges::reverse(arguments);
    app.parse(arguments);
  };
  EXPECT_THROW(parse({"record", "--split"}), CLI::RequiresError);
  EXPECT_THROW(parse({"record", "--split", "--max-mb", "0"}), CLI::ValidationError);
  EXPECT_NO_THROW(parse({"record", "--split", "--max-mb", "5"}));
}

TEST_F(RecordDiskTest, ARecorderThatDiesLeavesWhatItHadWritten) {
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

}  // namespace
}  // namespace splatbus::cli

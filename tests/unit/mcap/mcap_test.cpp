#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>

#include "mcap/reader.h"
#include "mcap/writer.h"

// What programs of others make of such a file: web/test/recording.test.mjs.
namespace splatbus::mcap {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

struct Read {
  std::string topic, data;
  std::uint32_t sequence;
  std::uint64_t log_time;
  bool operator==(const Read&) const = default;
};

class McapTest : public testing::Test {
 protected:
  McapTest() {
    std::string name = (fs::temp_directory_path() / "splatbus-mcap-XXXXXX").string();
    folder_ = ::mkdtemp(name.data());
    path_ = folder_ / "test.mcap";
  }
  ~McapTest() override { fs::remove_all(folder_); }

  [[nodiscard]] std::unique_ptr<Writer> writer(std::size_t chunk_bytes = 400) const {
    return std::make_unique<Writer>(
        create_file(path_), WriterOptions{.header = {.profile = "p", .library = "l"}, .chunk_bytes = chunk_bytes});
  }

  /// Forty messages on two channels, in several chunks.
  void write_messages(Writer& writer) {
    const auto schema = writer.add_schema("a.Table", "flatbuffer", std::vector<std::byte>(300, std::byte{7}));
    const auto first = writer.add_channel(schema, "first", "flatbuffer", {{"latched", "true"}});
    const auto second = writer.add_channel(0, "second", "raw", {});
    for (std::uint32_t i = 0; i < 40; ++i) {
      const std::string text = "message " + std::to_string(i) + std::string(i % 7, 'x');
      const bool of_first = i % 3 == 0;
      writer.write({.channel_id = of_first ? first : second,
                    .sequence = i,
                    .log_time = 1000 + i,
                    .publish_time = 900 + i,
                    .data = std::as_bytes(std::span(text))});
      written_.push_back({of_first ? "first" : "second", text, i, 1000 + i});
    }
    writer.write(Metadata{.name = "about", .values = {{"key", "value"}}});
  }

  static std::vector<Read> read_all(Reader& reader) {
    std::vector<Read> all;
    for (std::size_t chunk = 0; chunk < reader.summary().chunks.size(); ++chunk) {
      reader.read_chunk(chunk, [&](const Message& message) {
        all.push_back({reader.summary().channels.at(message.channel_id).topic,
                       std::string(reinterpret_cast<const char*>(message.data.data()), message.data.size()),
                       message.sequence, message.log_time});
      });
    }
    return all;
  }

  [[nodiscard]] std::string bytes() const {
    std::ifstream file(path_, std::ios::binary);
    return {std::istreambuf_iterator<char>(file), {}};
  }
  void write_bytes(const std::string& bytes) const {
    std::ofstream(path_, std::ios::binary | std::ios::trunc) << bytes;
  }

  fs::path folder_, path_;
  std::vector<Read> written_;
};

TEST_F(McapTest, WhatIsWrittenIsRead) {
  {
    const auto file = writer();
    write_messages(*file);
    file->close();
    EXPECT_EQ(file->bytes(), fs::file_size(path_));
  }
  Reader reader(path_);
  EXPECT_EQ(reader.damage(), "");
  EXPECT_EQ(reader.header().profile, "p");
  EXPECT_EQ(reader.header().library, "l");
  EXPECT_GT(reader.summary().chunks.size(), 3U);
  EXPECT_EQ(read_all(reader), written_);
  const Summary& summary = reader.summary();
  ASSERT_EQ(summary.schemas.size(), 1U);
  EXPECT_EQ(summary.schemas.begin()->second.name, "a.Table");
  EXPECT_EQ(summary.schemas.begin()->second.data, std::vector<std::byte>(300, std::byte{7}));
  EXPECT_EQ(summary.channels.at(1).metadata, (StringMap{{"latched", "true"}}));
  EXPECT_EQ(summary.statistics.message_count, 40U);
  EXPECT_EQ(summary.statistics.message_start_time, 1000U);
  EXPECT_EQ(summary.statistics.message_end_time, 1039U);
  EXPECT_EQ(summary.statistics.channel_message_counts.at(1), 14U);
  ASSERT_EQ(reader.read_metadata().size(), 1U);
  EXPECT_EQ(reader.read_metadata()[0].values, (StringMap{{"key", "value"}}));
}

TEST_F(McapTest, AChunksTimesAreThoseOfItsEarliestAndItsLatestMessage) {
  {
    const auto file = writer();
    const auto channel = file->add_channel(0, "t", "raw", {});
    for (const std::uint64_t time : {50U, 70U, 30U, 60U}) file->write({.channel_id = channel, .log_time = time});
    file->close_chunk();
    file->write({.channel_id = channel, .log_time = 40});
    file->close();
  }
  const auto expect_times = [](const Reader& reader) {
    ASSERT_EQ(reader.summary().chunks.size(), 2U);
    EXPECT_EQ(reader.summary().chunks[0].message_start_time, 30U);
    EXPECT_EQ(reader.summary().chunks[0].message_end_time, 70U);
    EXPECT_EQ(reader.summary().chunks[1].message_start_time, 40U);
    EXPECT_EQ(reader.summary().chunks[1].message_end_time, 40U);
  };
  expect_times(Reader(path_));
  const std::string whole = bytes();
  write_bytes(whole.substr(0, whole.size() - 1));
  expect_times(Reader(path_));  // as the chunks say it themselves
}

TEST_F(McapTest, ASummaryThatNamesARecordTwiceIsNotGoneBy) {
  {
    const auto file = writer();
    write_messages(*file);
    file->close();
  }
  const std::string whole = bytes();
  const std::uint64_t data_end = Reader(path_).data_end() - 13;  // DataEnd is written anew
  const Summary summary = Reader(path_).summary();
  const auto expect_scanned = [&](const Summary& lie, const char* record) {
    const std::vector<std::byte> end = file_end(lie, data_end);
    write_bytes(whole.substr(0, data_end) + std::string(reinterpret_cast<const char*>(end.data()), end.size()));
    Reader reader(path_);
    EXPECT_THAT(reader.damage(),
                testing::AllOf(HasSubstr(record), HasSubstr("the summary gives it an impossible place")));
    EXPECT_EQ(read_all(reader), written_);
    EXPECT_EQ(reader.read_metadata().size(), 1U);
  };
  Summary lie = summary;
  lie.chunks.insert(lie.chunks.begin() + 1, lie.chunks[1]);
  expect_scanned(lie, "Chunk at byte");
  lie = summary;
  lie.metadata.push_back(lie.metadata[0]);
  expect_scanned(lie, "Metadata at byte");
}

TEST_F(McapTest, ChunksAreCompressedWhereThatMakesThemSmaller) {
  std::string same(100'000, 'a'), noise;
  for (std::uint32_t state = 1; noise.size() < same.size();) {
    state = state * 1664525 + 1013904223;
    noise += static_cast<char>(state >> 24);
  }
  {
    const auto file = writer();
    const auto channel = file->add_channel(0, "t", "raw", {});
    file->write({.channel_id = channel, .data = std::as_bytes(std::span(same))});
    file->write({.channel_id = channel, .data = std::as_bytes(std::span(noise))});
    file->close();
  }
  Reader reader(path_);
  ASSERT_EQ(reader.summary().chunks.size(), 2U);
  EXPECT_EQ(reader.summary().chunks[0].compression, "zstd");
  EXPECT_LT(reader.summary().chunks[0].compressed_size, 1000U);
  EXPECT_EQ(reader.summary().chunks[1].compression, "");
  EXPECT_EQ(read_all(reader)[1].data, noise);
}

TEST_F(McapTest, AFileCutAnywhereReadsUpToItsLastWholeChunk) {
  {
    const auto file = writer();
    write_messages(*file);
    file->close();
  }
  const std::string whole = bytes();
  std::vector<std::uint64_t> chunk_ends;
  {
    const Reader reader(path_);
    for (const ChunkIndex& chunk : reader.summary().chunks) {
      chunk_ends.push_back(chunk.chunk_start_offset + chunk.chunk_length);
    }
  }
  std::size_t shown = 0;
  for (std::size_t size = whole.size() - 1; size > 30; size -= std::min<std::size_t>(size, 13)) {
    write_bytes(whole.substr(0, size));
    Reader reader(path_);
    EXPECT_THAT(reader.damage(), HasSubstr(" at byte ")) << size;
    EXPECT_EQ(reader.summary().chunks.size(),
              static_cast<std::size_t>(std::ranges::count_if(chunk_ends, [&](auto end) { return end <= size; })));
    const std::vector<Read> read = read_all(reader);
    EXPECT_TRUE(std::equal(read.begin(), read.end(), written_.begin()));
    EXPECT_EQ(reader.summary().statistics.message_count, read.size());
    shown = std::max(shown, read.size());

    const Recovered recovered = recover(path_);
    EXPECT_FALSE(recovered.damage.empty());
    Reader again(path_);
    EXPECT_EQ(again.damage(), "") << size;
    EXPECT_EQ(read_all(again), read);
    EXPECT_EQ(again.summary().statistics.message_count, read.size());
  }
  EXPECT_EQ(shown, written_.size());
  EXPECT_EQ(recover(path_).damage, "");
}

TEST_F(McapTest, RecoveryWritesWhatWasMissing) {
  {
    const auto file = writer();
    write_messages(*file);
    file->close();
  }
  const std::string whole = bytes();
  const std::uint64_t data_end = Reader(path_).data_end() - 13;  // DataEnd, which is written anew
  write_bytes(whole.substr(0, data_end));
  recover(path_);
  EXPECT_EQ(bytes(), whole);
  // Within the message indexes of the last chunk.
  const ChunkIndex last = Reader(path_).summary().chunks.back();
  write_bytes(whole.substr(0, last.chunk_start_offset + last.chunk_length + last.message_index_length / 2));
  recover(path_);
  const ChunkIndex now = Reader(path_).summary().chunks.back();
  EXPECT_EQ(now.message_index_offsets, last.message_index_offsets);
  EXPECT_EQ(now.message_index_length, last.message_index_length);
}

TEST_F(McapTest, ADamagedChunkIsRefusedAndTheOthersAreRead) {
  {
    const auto file = writer();
    write_messages(*file);
    file->close();
  }
  std::string changed = bytes();
  const std::size_t chunks = Reader(path_).summary().chunks.size();
  const ChunkIndex second = Reader(path_).summary().chunks[1];
  changed[second.chunk_start_offset + second.chunk_length - 20] ^= 1;
  write_bytes(changed);
  Reader reader(path_);
  EXPECT_NO_THROW(reader.read_chunk(0, [](const Message&) {}));
  EXPECT_THROW(
      {
        try {
          reader.read_chunk(1, [](const Message&) {});
        } catch (const Error& error) {
          EXPECT_THAT(error.what(), HasSubstr("test.mcap: Chunk at byte " + std::to_string(second.chunk_start_offset)));
          throw;
        }
      },
      Error);
  EXPECT_NO_THROW(reader.read_chunk(2, [](const Message&) {}));
  // Without a summary, too.
  write_bytes(changed.substr(0, changed.size() - 1));
  Reader scanned(path_);
  EXPECT_EQ(scanned.summary().chunks.size(), chunks - 1);
}

TEST_F(McapTest, ClaimsAreBounded) {
  {
    const auto file = writer();
    const std::string zeros(1'000'000, '\0');
    const auto channel = file->add_channel(0, "t", "raw", {});
    file->write({.channel_id = channel, .data = std::as_bytes(std::span(zeros))});
    file->close();
  }
  ReaderLimits limits{.chunk_bytes = 900'000};
  EXPECT_THROW(Reader(path_, limits).read_chunk(0, [](const Message&) {}), Error);
  // More than it says: the claim is at 16 bytes of the chunk's content.
  std::string lying = bytes();
  const std::uint64_t chunk = Reader(path_).summary().chunks[0].chunk_start_offset;
  const std::uint64_t claim = 1000;
  std::memcpy(lying.data() + chunk + 9 + 16, &claim, sizeof(claim));
  write_bytes(lying);
  EXPECT_THROW(Reader(path_).read_chunk(0, [](const Message&) {}), Error);
  // A record longer than the file.
  lying.resize(chunk + 20);
  const std::uint64_t endless = ~std::uint64_t{0} - 3;
  std::memcpy(lying.data() + chunk + 1, &endless, sizeof(endless));
  write_bytes(lying);
  EXPECT_THAT(Reader(path_).damage(), HasSubstr("the file ends within it"));
}

TEST_F(McapTest, OtherFilesAreRefused) {
  write_bytes("an OBJ file of some length, which is not a recording");
  EXPECT_THROW(Reader{path_}, Error);
  EXPECT_THROW(Reader{folder_ / "absent"}, Error);
  EXPECT_THROW((void)create_file(path_), Error) << "what exists is not written over";
}

}  // namespace
}  // namespace splatbus::mcap

// Log files, read back.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <unistd.h>

#include <array>
#include <filesystem>
#include <fstream>
#include <map>
#include <string>
#include <vector>

#include "bus/file_descriptor.h"
#include "log_store.h"
#include "supervised_run.h"

namespace splatbus::cli {
namespace {

namespace fs = std::filesystem;

/// Those that were there are read on where their past ends; one that comes later, from its start.
TEST(Logs, AreFollowedWithThoseThatComeLater) {
  const PrivateBusFolder folder;
  LogStore store(folder.path(), 4096, 3);
  const auto write = [&](const std::string& process, const std::string& text) {
    store.write({.process = process, .text = text, .event = {}});
  };
  for (int i = 0; i < 150; ++i) write("a", std::to_string(i));  // rotated once
  write("b", "not asked for");
  LogFollower follower(folder.path(), [](const std::string& process) { return process.starts_with("a"); });
  for (int i = 150; i < 260; ++i) write("a", std::to_string(i));  // and once more
  write("a.next", "stands by");
  write("a-2", "0");
  write("b", "nor now");
  const auto before = follower.before("", -1);
  ASSERT_EQ(before.size(), 150U);
  EXPECT_EQ(before.front().text, "0");
  EXPECT_EQ(before.back().text, "149");
  EXPECT_EQ(follower.before("", 3).front().text, "147");
  std::map<std::string, std::vector<std::string>> after;
  std::array<int, 2> ends{};
  ASSERT_EQ(pipe(ends.data()), 0);
  bus::FileDescriptor read_end(ends[0]);
  close(ends[1]);
  follower.run(read_end.get(), [&](const StoredLine& line) { after[line.process].push_back(line.text); });
  ASSERT_EQ(after["a"].size(), 110U);
  EXPECT_EQ(after["a"].front(), "150");
  EXPECT_EQ(after["a"].back(), "259");
  EXPECT_THAT(after["a.next"], testing::ElementsAre("stands by"));
  EXPECT_THAT(after["a-2"], testing::ElementsAre("0"));
  EXPECT_EQ(after.size(), 3U);
  EXPECT_THAT(logged_processes(folder.path()), testing::ElementsAre("a", "a-2", "a.next", "b"));
}

TEST(Logs, AreRotatedAndReadAcrossTheRotation) {
  const PrivateBusFolder folder;
  LogStore store(folder.path(), 4096, 3);
  for (int i = 0; i < 150; ++i) store.write({.process = "a", .text = std::to_string(i), .event = {}});
  store.write({.process = "b", .text = "started, process 7", .event = "started"});
  EXPECT_TRUE(fs::exists(folder.path() / "a.1.log"));
  EXPECT_THAT(logged_processes(folder.path()), testing::ElementsAre("a", "b"));
  const auto all = read_logs(folder.path(), {"a"}, "", -1);
  ASSERT_EQ(all.size(), 150U);
  EXPECT_EQ(all.front().text, "0");
  EXPECT_EQ(all.back().text, "149");
  const auto last = read_logs(folder.path(), {"a", "b"}, "", 2);
  ASSERT_EQ(last.size(), 2U);
  EXPECT_EQ(last[0].text, "149");
  EXPECT_TRUE(last[1].event);
  EXPECT_EQ(read_logs(folder.path(), {"a"}, all[100].time, -1).front().time, all[100].time);
  for (int i = 0; i < 2000; ++i) store.write({.process = "a", .text = std::to_string(i), .event = {}});
  EXPECT_LE(fs::file_size(folder.path() / "a.1.log"), 4096U);
  EXPECT_FALSE(fs::exists(folder.path() / "a.4.log"));
  EXPECT_THROW(static_cast<void>(since_time("yesterday")), std::runtime_error);
  EXPECT_LT(since_time("2h"), since_time("10m"));
}

/// As the kernel counts what this process reads.
std::uint64_t bytes_read() {
  std::ifstream io("/proc/self/io");
  std::string key;
  std::uint64_t bytes = 0;
  io >> key >> bytes;
  EXPECT_EQ(key, "rchar:");
  return bytes;
}

TEST(Logs, TheLastLinesAreReadFromTheEnd) {
  const PrivateBusFolder folder;
  constexpr int kLines = 50'000;
  const auto time = [](int number) { return fmt::format("2026-11-27T10:00:00.{:06}Z", number); };
  {
    std::ofstream older(folder.path() / "a.1.log"), newer(folder.path() / "a.log");
    for (int i = 0; i < kLines; ++i) {
      older << fmt::format("{} | {}\n", time(i), i);
      newer << fmt::format("{} | {}\n", time(kLines + i), kLines + i);
    }
  }
  const std::uintmax_t size = fs::file_size(folder.path() / "a.log");
  std::uint64_t before = bytes_read();
  const auto last = read_logs(folder.path(), {"a"}, "", 10);
  EXPECT_LT(bytes_read() - before, size / 10);
  ASSERT_EQ(last.size(), 10U);
  EXPECT_EQ(last.front().text, std::to_string(2 * kLines - 10));
  EXPECT_EQ(last.back().text, std::to_string(2 * kLines - 1));

  before = bytes_read();
  const auto since = read_logs(folder.path(), {"a"}, time(2 * kLines - 10), -1);
  EXPECT_LT(bytes_read() - before, size / 10);
  ASSERT_EQ(since.size(), 10U);
  EXPECT_EQ(since.front().text, std::to_string(2 * kLines - 10));

  // More than a file has, and whatever the blocks of reading are.
  const auto many = read_logs(folder.path(), {"a"}, "", kLines + 3);
  ASSERT_EQ(many.size(), static_cast<std::size_t>(kLines + 3));
  EXPECT_EQ(many.front().text, std::to_string(kLines - 3));
  EXPECT_EQ(read_logs(folder.path(), {"a"}, "", -1).size(), static_cast<std::size_t>(2 * kLines));
}

}  // namespace
}  // namespace splatbus::cli

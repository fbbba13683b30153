// The supervisor's socket, and the log files.
#include <gmock/gmock.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <condition_variable>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <future>
#include <map>
#include <mutex>
#include <nlohmann/json.hpp>

#include "bus/file_descriptor.h"
#include "control_request.h"
#include "control_server.h"
#include "log_store.h"
#include "supervised_run.h"

namespace splatbus::cli {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;
using testing::HasSubstr;

std::string what_is_thrown(const std::function<void()>& act) {
  try {
    act();
  } catch (const std::exception& error) {
    return error.what();
  }
  return "nothing";
}

TEST(Control, AnswersAndRefusals) {
  const PrivateBusFolder folder;
  ControlServer server(folder.address());
  server.handle("double", [](const Json& request, const auto& tell, const auto&) {
    tell("thinking");
    return Json{{"result", 2 * request.at("of").get<int>()}};
  });
  server.start();
  std::string progress;
  EXPECT_EQ(ask_supervisor(folder.address(), {{"verb", "double"}, {"of", 21}}, [&](const auto& p) { progress = p; })
                .at("result"),
            42);
  EXPECT_EQ(progress, "thinking");
  EXPECT_THAT(what_is_thrown([&] {
                static_cast<void>(ask_supervisor(folder.address(), {{"verb", "dance"}}));
              }),
              HasSubstr("'dance'"));
  EXPECT_THAT(what_is_thrown([&] {
                static_cast<void>(ask_supervisor(folder.address(), {{"verb", "double"}}));
              }),
              HasSubstr("of"));
  LineSocket other = connect_control(folder.address());
  ASSERT_TRUE(other.send({{"version", 99}, {"verb", "double"}, {"of", 1}}));
  EXPECT_FALSE(other.receive()->value("ok", true));
  ASSERT_TRUE(other.send_line("no JSON"));
  EXPECT_FALSE(other.receive()->value("ok", true));
  EXPECT_FALSE(other.receive()) << "the connection is closed";
}

TEST(Control, OneSupervisorABus) {
  const PrivateBusFolder folder;
  const ControlServer first(folder.address());
  EXPECT_THAT(what_is_thrown([&] { ControlServer second(folder.address()); }),
              HasSubstr("(process " + std::to_string(getpid()) + ")"));
}

TEST(Control, TheSocketOfADeadSupervisorIsTakenOver) {
  const PrivateBusFolder folder;
  const fs::path path = control_paths(folder.address()).socket;
  {
    bus::FileDescriptor dead(socket(AF_UNIX, SOCK_STREAM, 0));
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    std::memcpy(address.sun_path, path.c_str(), path.native().size());
    ASSERT_EQ(bind(dead.get(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)), 0);
  }
  ASSERT_TRUE(fs::exists(path));
  EXPECT_THROW(static_cast<void>(connect_control(folder.address())), NoSupervisor);
  ControlServer server(folder.address());
  server.handle("ping", [](const Json&, const auto&, const auto&) { return Json::object(); });
  server.start();
  EXPECT_TRUE(ask_supervisor(folder.address(), {{"verb", "ping"}}).value("ok", false));
  struct stat status {};
  ASSERT_EQ(stat(path.c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 077U, 0U) << "for its owner alone";
}

TEST(Control, WhoIsAttachedHearsWhatIsPublished) {
  const PrivateBusFolder folder;
  std::optional<ControlServer> server(folder.address());
  server->start();
  LineSocket socket = connect_control(folder.address());
  ASSERT_TRUE(socket.send({{"version", kControlVersion}, {"verb", "attach"}}));
  ASSERT_TRUE(socket.receive()->value("ok", false));
  server->publish_line(event_json({.process = "a", .text = "hello \xff", .event = {}}));
  EXPECT_THAT(socket.receive()->value("line", ""), HasSubstr("hello"));
  server.reset();
  EXPECT_FALSE(socket.receive());
}

/// What handlers refer to goes right after that.
TEST(Control, NoVerbRunsOnceItHasStopped) {
  const PrivateBusFolder folder;
  ControlServer server(folder.address());
  std::promise<void> entered;
  std::atomic<bool> left = false;
  server.handle("wait", [&](const Json&, const auto&, const std::stop_token& stop) {
    std::mutex mutex;
    std::unique_lock lock(mutex);
    entered.set_value();
    std::condition_variable_any().wait(lock, stop, [] { return false; });
    left = true;
    return Json::object();
  });
  server.start();
  LineSocket socket = connect_control(folder.address());
  ASSERT_TRUE(socket.send({{"version", kControlVersion}, {"verb", "wait"}}));
  entered.get_future().wait();
  server.stop();
  EXPECT_TRUE(left);
  EXPECT_NO_THROW(ControlServer second(folder.address())) << "the place is free";
}

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

}  // namespace
}  // namespace splatbus::cli

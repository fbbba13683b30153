// The supervisor's socket.
#include <gmock/gmock.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstring>
#include <filesystem>
#include <future>
#include <mutex>
#include <nlohmann/json.hpp>
#include <thread>
#include <vector>

#include "bus/file_descriptor.h"
#include "control_request.h"
#include "control_server.h"
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

/// A supervisor that is there and does nothing: stopped by a signal, say.
class Mute {
 public:
  explicit Mute(const bus::Address& bus) : listener_(bus) {}
  void accept() {
    connections_.emplace_back(::accept4(listener_.fd(), nullptr, nullptr, SOCK_CLOEXEC));
    ASSERT_TRUE(connections_.back().valid());
  }
  void say(const std::string& line) {
    ASSERT_EQ(::send(connections_.back().get(), line.data(), line.size(), MSG_NOSIGNAL),
              static_cast<ssize_t>(line.size()));
  }

 private:
  ControlListener listener_;
  std::vector<bus::FileDescriptor> connections_;
};

TEST(Control, WhoSaysNothingIsNotWaitedForForEver) {
  const PrivateBusFolder folder;
  const Mute mute(folder.address());
  const auto ask = [&](Json request) {
    const auto start = std::chrono::steady_clock::now();
    EXPECT_THAT(what_is_thrown([&] { static_cast<void>(ask_supervisor(folder.address(), request, {}, 0.2)); }),
                testing::AllOf(HasSubstr("(process " + std::to_string(getpid()) + ")"), HasSubstr("has not answered")));
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  };
  const double status_s = ask({{"verb", "status"}});
  EXPECT_GE(status_s, 0.2);
  EXPECT_LT(status_s, 30);
  EXPECT_GE(ask({{"verb", "scale"}, {"wait_s", 1.0}}), 1.2) << "a verb has the time that it asks for";
}

TEST(Control, EveryWordOfASupervisorCounts) {
  const PrivateBusFolder folder;
  Mute mute(folder.address());
  const std::jthread supervisor([&] {
    mute.accept();
    for (int step = 0; step < 4; ++step) {
      std::this_thread::sleep_for(std::chrono::milliseconds(500));
      mute.say("{\"progress\": \"restarting another\"}\n");
    }
    mute.say("{\"ok\": true}\n");
  });
  EXPECT_TRUE(ask_supervisor(folder.address(), {{"verb", "restart"}, {"wait_s", 1.0}}, {}, 0.5).value("ok", false))
      << "two seconds in all, and never 1.5 in silence";
}

TEST(Control, DownSaysWhatHasNotEnded) {
  const PrivateBusFolder folder;
  ControlServer server(folder.address());
  std::jthread ending;
  int asked = 0;
  server.handle("down", [&](const Json&, const auto&, const auto&) {
    if (++asked == 2) ending = std::jthread([&] { server.stop(); });
    return Json{{"processes", {"a", "b"}}};
  });
  server.handle("status", [](const Json&, const auto&, const auto&) {
    return Json{{"services", {{{"name", "a"}}, {{"name", "b"}, {"pid", 7}}}}};
  });
  server.start();
  EXPECT_THAT(what_is_thrown([&] { static_cast<void>(stop_supervisor(folder.address(), 0.2)); }),
              HasSubstr("within 0.2 s; still there: b"));
  EXPECT_EQ(stop_supervisor(folder.address(), 60).at("processes").size(), 2U);
}

}  // namespace
}  // namespace splatbus::cli

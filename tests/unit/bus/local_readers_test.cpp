#include "bus/local_readers.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/ioctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <optional>
#include <thread>
#include <utility>
#include <zmq.hpp>

#include "../../hostile/raw_zmtp.h"
#include "bus_fixture.h"

namespace splatbus::bus_service {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;

/// The broker's XPUB, with LocalReaders behind it.
class LocalReadersTest : public testing::Test {
 protected:
  LocalReadersTest() : endpoint_("ipc://" + folder_.path() + "/xpub") {
    xpub_.set(zmq::sockopt::xpub_verbose, true);
    xpub_.set(zmq::sockopt::rcvtimeo, 60'000);
    xpub_.set(zmq::sockopt::linger, 0);
    xpub_.bind(endpoint_);
  }

  /// One subscription, or its end, that arrives.
  void note_one() {
    zmq::message_t event;
    ASSERT_TRUE(xpub_.recv(event).has_value());
    const std::string text = event.to_string();
    readers_.note(event, text.substr(1), text[0] == 1);
  }

  std::optional<zmq::socket_t> subscribe(const std::vector<std::string>& prefixes) {
    zmq::socket_t reader(zmq_, zmq::socket_type::sub);
    reader.set(zmq::sockopt::linger, 0);
    for (const std::string& prefix : prefixes) reader.set(zmq::sockopt::subscribe, prefix);
    reader.connect(endpoint_);
    for (std::size_t i = 0; i < prefixes.size(); ++i) note_one();
    return reader;
  }

  [[nodiscard]] std::string own_name() const { return fmt::format("pid {}", ::getpid()); }
  [[nodiscard]] std::set<std::string> names(const std::string& topic) const { return readers_.names(topic, nodes_); }

  bus_test::TemporaryDirectory folder_;
  std::string endpoint_;
  zmq::context_t zmq_;
  zmq::socket_t xpub_{zmq_, zmq::socket_type::xpub};
  LocalReaders readers_;
  std::map<std::string, Liveness::Node> nodes_;
};

TEST_F(LocalReadersTest, NamesWhoReadsATopicByItsHeartbeat) {
  const auto reader = subscribe({"engine/", "sys/log"});
  EXPECT_THAT(names("engine/frame"), ElementsAre(own_name())) << "without a heartbeat";
  EXPECT_THAT(names("sys/logs"), ElementsAre(own_name()));
  EXPECT_THAT(names("sys/topics"), IsEmpty());

  const auto pid = static_cast<std::uint32_t>(::getpid());
  nodes_["trainer"] = {.service = "trainer", .pid = pid, .alive = true};
  nodes_["viewer"] = {.service = "viewer", .pid = pid, .alive = true};
  nodes_["other"] = {.service = "other", .pid = pid + 1, .alive = true};
  EXPECT_THAT(names("engine/frame"), ElementsAre("trainer", "viewer")) << "two sources of one process";
  nodes_["trainer"].alive = nodes_["viewer"].alive = false;
  EXPECT_THAT(names("engine/frame"), ElementsAre(own_name())) << "the dead read nothing";
}

TEST_F(LocalReadersTest, TellsProcessesApartByTheKernel) {
  const auto own = subscribe({"engine/"});
  int go[2];
  ASSERT_EQ(::pipe(go), 0);
  const pid_t child = ::fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    ::close(go[1]);
    zmq::context_t zmq;
    zmq::socket_t reader(zmq, zmq::socket_type::sub);
    reader.set(zmq::sockopt::subscribe, "engine/frame");
    reader.connect(endpoint_);
    char byte = 0;
    static_cast<void>(::read(go[0], &byte, 1));  // until the other end is closed
    ::_exit(0);
  }
  ::close(go[0]);
  note_one();
  EXPECT_THAT(names("engine/frame"), testing::UnorderedElementsAre(own_name(), fmt::format("pid {}", child)));
  EXPECT_THAT(names("engine/cameras"), ElementsAre(own_name()));
  ::close(go[1]);
  ::waitpid(child, nullptr, 0);
  readers_.forget_closed();
  EXPECT_THAT(names("engine/frame"), ElementsAre(own_name())) << "a process that ended reads no more";
}

TEST_F(LocalReadersTest, ForgetsWhoUnsubscribesOrLeaves) {
  auto reader = subscribe({"engine/", "sys/log"});
  reader->set(zmq::sockopt::unsubscribe, "engine/");
  note_one();
  EXPECT_THAT(names("engine/frame"), IsEmpty());
  EXPECT_THAT(names("sys/log"), ElementsAre(own_name()));
  readers_.forget_closed();
  EXPECT_THAT(names("sys/log"), ElementsAre(own_name())) << "who is there stays";
  reader.reset();
  EXPECT_TRUE(bus_test::eventually([&] {
    readers_.forget_closed();
    return names("sys/log").empty();
  }));
}

TEST_F(LocalReadersTest, WhoTakesNothingForSecondsIsClosedWhenThatIsAsked) {
  constexpr std::int64_t kSecond = 1'000'000'000;
  xpub_.set(zmq::sockopt::sndtimeo, 0);
  hostile::RawZmtp stopped(endpoint_);
  ASSERT_TRUE(stopped.handshake("SUB"));
  ASSERT_TRUE(stopped.send_frame("\x01many", false));
  note_one();
  auto good = subscribe({"many"});
  const auto flood = [&] {
    zmq::message_t taken;
    for (int i = 0; i < 20; ++i) {
      xpub_.send(zmq::buffer("many" + std::string(1 << 20, 'x')), zmq::send_flags::dontwait);
      good->set(zmq::sockopt::rcvtimeo, 5000);
      ASSERT_TRUE(good->recv(taken).has_value());
    }
  };
  flood();
  readers_.look(kSecond);
  EXPECT_TRUE(readers_.close_stuck(kSecond).empty());
  readers_.look(3 * kSecond);
  EXPECT_TRUE(readers_.close_stuck(4 * kSecond - 1).empty()) << "it may be that slow";
  EXPECT_FALSE(stopped.closed_within(std::chrono::milliseconds(1)));
  EXPECT_EQ(readers_.close_stuck(4 * kSecond).size(), 1U);
  EXPECT_TRUE(bus_test::eventually([&] { return stopped.closed_within(std::chrono::milliseconds(100)); }));
  flood();
}

TEST_F(LocalReadersTest, WhoReadsOnIsNotStuckHoweverMuchWaits) {
  constexpr std::int64_t kSecond = 1'000'000'000;
  xpub_.set(zmq::sockopt::sndtimeo, 0);
  hostile::RawZmtp slow(endpoint_);
  ASSERT_TRUE(slow.handshake("SUB"));
  ASSERT_TRUE(slow.send_frame("\x01many", false));
  note_one();
  for (int i = 0; i < 20; ++i) xpub_.send(zmq::buffer("many" + std::string(1 << 20, 'x')), zmq::send_flags::dontwait);
  // Until the kernel has as much as it takes.
  const auto untaken = [&] {
    int bytes = 0;
    ::ioctl(slow.fd(), FIONREAD, &bytes);
    return bytes;
  };
  int before = -1;
  ASSERT_TRUE(bus_test::eventually([&] {
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
    return untaken() > 0 && std::exchange(before, untaken()) == untaken();
  }));
  readers_.look(kSecond);
  const int half = untaken() / 2;
  for (int taken = 0; taken < half + 1000;) {
    const std::string some =
        slow.read_some(static_cast<std::size_t>(half + 1000 - taken), std::chrono::milliseconds(5000));
    ASSERT_FALSE(some.empty());
    taken += static_cast<int>(some.size());
  }
  ASSERT_GT(untaken(), 0);
  readers_.look(3 * kSecond);
  EXPECT_TRUE(readers_.close_stuck(4 * kSecond).empty()) << "it has taken some";
  readers_.look(5 * kSecond);
  EXPECT_EQ(readers_.close_stuck(6 * kSecond).size(), 1U) << "and none since";
}

TEST_F(LocalReadersTest, NamesAndPrefixesAreBounded) {
  std::vector<std::string> prefixes;
  for (int i = 0; i < 256; ++i) prefixes.push_back(fmt::format("many/{}/", i));
  auto reader = subscribe(prefixes);
  reader->set(zmq::sockopt::subscribe, "one/more");
  note_one();
  EXPECT_THAT(names("many/255/x"), ElementsAre(own_name()));
  EXPECT_THAT(names("one/more"), IsEmpty());
  for (std::uint32_t i = 0; i < 20; ++i) {
    nodes_[fmt::format("node{:02}", i)] = {.pid = static_cast<std::uint32_t>(::getpid()), .alive = true};
  }
  EXPECT_LE(names("many/1/x").size(), 16U);
}

}  // namespace
}  // namespace splatbus::bus_service

#include "streamer/endpoint.h"

#include <gmock/gmock.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <thread>

#include "../../bus/bus_fixture.h"
#include "bus/error.h"
#include "bus/private_folder.h"
#include "stream/relay_client.h"

namespace splatbus::streamer {
namespace {

class EndpointTest : public testing::Test {
 protected:
  EndpointTest() : endpoint_({"ipc://" + directory_.path() + "/streamer"}) {}

  zmq::socket_t connect(const std::string& routing_id) {
    zmq::socket_t socket(context_, zmq::socket_type::dealer);
    socket.set(zmq::sockopt::linger, 0);
    socket.set(zmq::sockopt::routing_id, routing_id);
    socket.connect(endpoint_.bound().front());
    return socket;
  }

  static void send(zmq::socket_t& socket, const std::vector<stream::Bytes>& parts) {
    for (std::size_t i = 0; i < parts.size(); ++i) {
      (void)socket.send(zmq::buffer(parts[i]), i + 1 < parts.size() ? zmq::send_flags::sndmore : zmq::send_flags::none);
    }
  }

  [[nodiscard]] stream::Bytes bye() const {
    return writer_.write(1, 0, wire::Body::Bye, [](auto& b) { return wire::CreateByeDirect(b, "x"); }).packet;
  }
  [[nodiscard]] stream::Bytes hello() const {
    return writer_.write(1, 0, wire::Body::Hello, [](auto& b) { return wire::CreateHelloDirect(b, "x"); }).packet;
  }

  /// All that arrives up to and with the next Hello.
  std::vector<Endpoint::Received> receive_to_hello() {
    std::vector<Endpoint::Received> all;
    EXPECT_TRUE(bus_test::eventually([&] {
      while (const auto received = endpoint_.receive()) {
        all.push_back(*received);
        if (received->packet.body() == wire::Body::Hello) return true;
      }
      return false;
    }));
    return all;
  }

  bus_test::TemporaryDirectory directory_;
  zmq::context_t context_;
  Endpoint endpoint_;
  stream::PacketWriter writer_{"viewer", 1};
};

TEST_F(EndpointTest, AMessageOfManyPartsIsRefusedWholeAndSpeaksForNobodyElse) {
  zmq::socket_t victim = connect("victim"), hostile = connect("hostile");
  send(victim, {hello()});
  ASSERT_EQ(receive_to_hello().back().peer, "victim");
  const stream::Bytes victims_id{'v', 'i', 'c', 't', 'i', 'm'};
  send(hostile, {bye(), victims_id, bye()});
  send(hostile, {bye(), {}, victims_id, bye()});
  send(hostile, std::vector<stream::Bytes>(50, bye()));
  send(hostile, {hello()});
  const auto received = receive_to_hello();
  ASSERT_EQ(received.size(), 1U) << received.front().peer << " is said to have sent a part of another's message";
  EXPECT_EQ(received.front().peer, "hostile");
  EXPECT_EQ(endpoint_.malformed(), 3U);
}

// A streamer that is busy for a while: libzmq ended the process.
TEST_F(EndpointTest, OneThatSaidMoreThanWaitsAndLeftIsSurvivedThoughNobodyReadForLong) {
  {
    zmq::socket_t hasty = connect("hasty");
    // Until nobody takes any more: every queue on the way is full.
    hasty.set(zmq::sockopt::sndtimeo, 1000);
    int sent = 0;
    while (sent < 100'000 && hasty.send(zmq::buffer(bye()), zmq::send_flags::none)) ++sent;
    ASSERT_LT(sent, 100'000);
  }
  std::this_thread::sleep_for(std::chrono::seconds(3));  // while heartbeats, if there were any, came due
  zmq::socket_t viewer = connect("viewer");
  send(viewer, {hello()});
  EXPECT_EQ(receive_to_hello().back().peer, "viewer");
}

TEST_F(EndpointTest, PacketAndPayloadArriveTogether) {
  zmq::socket_t viewer = connect("viewer");
  send(viewer, {bye(), {1, 2, 3}});
  send(viewer, {hello()});
  const auto received = receive_to_hello();
  ASSERT_EQ(received.size(), 2U);
  EXPECT_TRUE(std::ranges::equal(received[0].packet.payload(), stream::Bytes{1, 2, 3}));
  EXPECT_EQ(endpoint_.malformed(), 0U);
}

TEST_F(EndpointTest, GarbageTakesItsShareOfATurnAndNoMore) {
  zmq::socket_t hostile = connect("hostile");
  hostile.set(zmq::sockopt::sndhwm, 0);
  for (int i = 0; i < 3000; ++i) send(hostile, {{1, 2, 3}});
  std::uint64_t most = 0;
  ASSERT_TRUE(bus_test::eventually([&] {
    const std::uint64_t before = endpoint_.malformed();
    EXPECT_FALSE(endpoint_.receive().has_value());
    most = std::max(most, endpoint_.malformed() - before);
    return endpoint_.malformed() == 3000;
  }));
  EXPECT_LE(most, 256U);
}

TEST_F(EndpointTest, AServicesClientsCountByThemselves) {
  zmq::socket_t gateway = connect("gateway");
  const auto bytes = [](const std::string& text) { return stream::Bytes(text.begin(), text.end()); };
  const stream::Bytes rights = bytes(bus::rights_frame({.view = true}));
  send(gateway, {hello()});
  EXPECT_EQ(receive_to_hello().back().address, "") << "itself, over ipc";
  send(gateway, {rights, bytes(stream::client_frame(7)), hello()});
  const Endpoint::Received received = receive_to_hello().back();
  EXPECT_EQ(received.address, stream::client_frame(7));
  EXPECT_EQ(received.rights, bus::Rights{.view = true});
  EXPECT_TRUE(received.is_service);
  EXPECT_EQ(endpoint_.malformed(), 0U);
}

TEST_F(EndpointTest, LiesWhereNobodyElseCouldHavePutIt) {
  const auto refusal = [](const std::string& endpoint) {
    try {
      Endpoint refused({endpoint});
    } catch (const bus::Error& error) {
      return std::string(error.what());
    }
    return std::string();
  };
  const std::string open = directory_.path() + "/open", others = directory_.path() + "/others";
  for (const std::string& folder : {open, others}) ASSERT_EQ(::mkdir(folder.c_str(), 0700), 0);
  ASSERT_EQ(::chmod(open.c_str(), 0777), 0);
  EXPECT_THAT(refusal("ipc://" + open + "/s"), testing::HasSubstr("others may write to its folder"));
  EXPECT_THAT(refusal("ipc://@splatbus"), testing::HasSubstr("without a folder"));
  EXPECT_EQ(refusal("ipc://" + directory_.path() + "/made/s"), "");
  struct stat made {};
  ASSERT_EQ(::stat((directory_.path() + "/made").c_str(), &made), 0);
  EXPECT_EQ(made.st_mode & 0777U, 0700U);
  if (::getegid() == ::geteuid()) {
    ASSERT_EQ(::chmod(open.c_str(), 0775), 0);
    EXPECT_EQ(refusal("ipc://" + open + "/s"), "") << "its group is this user's own";
  }
  if (::geteuid() != 0) GTEST_SKIP() << "the rest takes root";
  ASSERT_EQ(::chown(open.c_str(), 0, 65534), 0);
  EXPECT_THAT(refusal("ipc://" + open + "/s"), testing::HasSubstr("others may write to its folder"));
  ASSERT_EQ(::chown(others.c_str(), 65534, 65534), 0);
  EXPECT_THAT(refusal("ipc://" + others + "/s"), testing::HasSubstr("another user"));
  const std::string link = directory_.path() + "/link";
  ASSERT_EQ(::symlink((directory_.path() + "/made").c_str(), link.c_str()), 0);
  EXPECT_EQ(refusal("ipc://" + link + "/s"), "") << "this user's own link";
  ASSERT_EQ(::lchown(link.c_str(), 65534, 65534), 0);
  EXPECT_THAT(refusal("ipc://" + link + "/s"), testing::HasSubstr("a link of another user"));
}

// As /tmp is.
TEST_F(EndpointTest, WhereNobodyMovesWhatIsAnothersItsOwnSocketIsThere) {
  const std::string folder = directory_.path() + "/tmp", path = folder + "/s", address = "ipc://" + path;
  ASSERT_EQ(::mkdir(folder.c_str(), 0700), 0);
  ASSERT_EQ(::chmod(folder.c_str(), 01777), 0);
  const auto refusal = [&] {
    try {
      bus::require_own_endpoint(address);
    } catch (const bus::Error& error) {
      return std::string(error.what());
    }
    return std::string();
  };
  EXPECT_THAT(refusal(), testing::HasSubstr("nothing listens there yet"));
  const Endpoint bound({address});
  EXPECT_EQ(refusal(), "");
  ASSERT_EQ(::chmod(path.c_str(), 0722), 0);
  EXPECT_THAT(refusal(), testing::HasSubstr("others may write to it"));
  if (::geteuid() != 0) GTEST_SKIP() << "the rest takes root";
  ASSERT_EQ(::chmod(path.c_str(), 0700), 0);
  ASSERT_EQ(::chown(path.c_str(), 65534, 65534), 0);
  EXPECT_THAT(refusal(), testing::HasSubstr("another user"));
}

TEST_F(EndpointTest, OverIpcAnotherUserIsNotHeardEvenWhereTheDoorIsOpen) {
  if (::geteuid() != 0) GTEST_SKIP() << "takes root";
  const std::string path = directory_.path() + "/streamer";
  ASSERT_EQ(::chmod(directory_.path().c_str(), 0755), 0);
  ASSERT_EQ(::chmod(path.c_str(), 0777), 0);
  const std::string address = endpoint_.bound().front();
  const stream::Bytes word = hello();
  const pid_t other = ::fork();
  if (other == 0) {
    if (::setuid(65534) != 0) ::_exit(1);
    zmq::context_t context;
    zmq::socket_t socket(context, zmq::socket_type::dealer);
    socket.set(zmq::sockopt::linger, 1000);
    socket.connect(address);
    (void)socket.send(zmq::buffer(word), zmq::send_flags::none);
    socket.close();
    context.close();
    ::_exit(0);
  }
  int status = 0;
  ASSERT_EQ(::waitpid(other, &status, 0), other);
  ASSERT_EQ(status, 0);
  zmq::socket_t own = connect("own");
  send(own, {hello()});
  const auto received = receive_to_hello();
  ASSERT_EQ(received.size(), 1U);
  EXPECT_EQ(received.front().peer, "own");
}

}  // namespace
}  // namespace splatbus::streamer

#include "bus/sources.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <deque>

#include "bus_fixture.h"

namespace splatbus::bus_service {
namespace {

/// A broker's socket and what connects to it, without a broker.
class SourcesTest : public testing::Test {
 protected:
  void SetUp() override {
    broker_.set(zmq::sockopt::rcvtimeo, 5000);
    broker_.bind(endpoint_);
    broker_.send(zmq::message_t(std::string_view("\x01")), zmq::send_flags::none);  // subscribes to all
  }
  zmq::socket_t connect() {
    zmq::socket_t socket(context_, zmq::socket_type::xpub);
    socket.connect(endpoint_);
    zmq::message_t subscription;
    // The broker's socket takes a connection up when something is asked of it.
    EXPECT_TRUE(bus_test::eventually([&] {
      (void)broker_.get(zmq::sockopt::events);
      return socket.recv(subscription, zmq::recv_flags::dontwait).has_value();
    }));
    return socket;
  }
  static void send(zmq::socket_t& socket) {
    socket.send(zmq::buffer(std::string_view("topic")), zmq::send_flags::none);
  }
  zmq::message_t receive() {
    zmq::message_t frame;
    EXPECT_TRUE(broker_.recv(frame).has_value());
    return frame;
  }
  bool admit(const char* name, zmq::message_t& frame) { return sources_.admit(name, 1, frame, true, 1, why_); }

  const bus_test::TemporaryDirectory directory_;
  const std::string endpoint_ = "ipc://" + directory_.path() + "/socket";
  zmq::context_t context_;
  zmq::socket_t broker_{context_, zmq::socket_type::xsub};
  Sources sources_;
  std::string why_;
};

TEST_F(SourcesTest, ANameIsItsFirstConnectionsUntilThatCloses) {
  auto first = connect(), second = connect();
  send(first);
  auto of_first = receive();
  EXPECT_TRUE(admit("trainer", of_first));
  send(second);
  auto of_second = receive();
  EXPECT_FALSE(admit("trainer", of_second));
  EXPECT_EQ(why_, "another process has that name, and is there");
  const auto socket = bus::PeerSocket::of(of_first);
  first.close();
  ASSERT_TRUE(bus_test::eventually([&] { return !socket.is_open(); }));
  EXPECT_TRUE(admit("trainer", of_second));
}

/// With connections that come and go by the dozen.
class SourcesPlaces : public SourcesTest {
 protected:
  /// A new connection's frame.
  zmq::message_t& next_connection() {
    sockets_.push_back(connect());
    send(sockets_.back());
    return frames_.emplace_back(receive());
  }
  bool admit_one(zmq::message_t& frame, bool local) {
    return sources_.admit("source" + std::to_string(next_name_++), 1, frame, local, 1, why_);
  }
  /// By new connections, until there is no place.
  std::size_t fill_remote_places() {
    for (std::size_t admitted = 0;;) {
      auto& frame = next_connection();
      for (std::size_t k = 0; k < Sources::kMaxOfARemoteConnection; ++k, ++admitted) {
        if (!admit_one(frame, false)) return admitted;
      }
    }
  }

  std::vector<zmq::socket_t> sockets_;
  std::deque<zmq::message_t> frames_;
  std::size_t next_name_ = 0;
};

TEST_F(SourcesPlaces, AreAKindsOwnAndBoundedAConnection) {
  auto& greedy = next_connection();
  for (std::size_t k = 0; k < Sources::kMaxOfARemoteConnection; ++k) ASSERT_TRUE(admit_one(greedy, false)) << why_;
  EXPECT_FALSE(admit_one(greedy, false));
  EXPECT_EQ(why_, "one connection calls itself by too many names");
  EXPECT_EQ(fill_remote_places(), Sources::kMaxOfAKind - Sources::kMaxOfARemoteConnection);
  EXPECT_EQ(why_, "there are too many sources");
  auto& far = frames_.back();
  auto& here = next_connection();
  EXPECT_TRUE(admit_one(here, true)) << "this machine's have places of their own";
  EXPECT_TRUE(sources_.admit("source0", 1, here, true, 1, why_)) << "and take names, which leaves a place";
  EXPECT_TRUE(admit_one(far, false)) << why_;
  EXPECT_FALSE(admit_one(far, false));
}

TEST_F(SourcesPlaces, OfThoseWhoAreGoneAreFoundBitByBit) {
  ASSERT_EQ(fill_remote_places(), Sources::kMaxOfAKind);
  std::vector<bus::PeerSocket> peers;
  for (const auto& frame : frames_) peers.push_back(bus::PeerSocket::of(frame));
  sockets_.clear();
  ASSERT_TRUE(bus_test::eventually([&] { return std::ranges::none_of(peers, &bus::PeerSocket::is_open); }));
  EXPECT_EQ(fill_remote_places(), 0U) << "a name that finds no place does not look at all the others";
  sources_.forget_some();
  const std::size_t found = fill_remote_places();
  EXPECT_GT(found, 0U);
  EXPECT_LE(found, Sources::kMaxOfAKind / 4) << "each costs system calls on the relay's thread";
  for (int i = 0; i < 20; ++i) sources_.forget_some();
  EXPECT_EQ(fill_remote_places(), Sources::kMaxOfAKind - found);
}

/// What a connection sent last is read once its descriptor's number is another's, as when a successor takes over.
TEST_F(SourcesTest, ALastMessageDoesNotGiveTheNameToWhoGotTheDescriptor) {
  auto leaves = connect();
  send(leaves);
  auto frame = receive();
  ASSERT_TRUE(admit("trainer.next", frame));
  send(leaves);
  const auto socket = bus::PeerSocket::of(frame);
  leaves.close();
  ASSERT_TRUE(bus_test::eventually([&] { return !socket.is_open() && bus::cookie_of(socket.fd) != socket.cookie; }));
  // Sooner or later one of these gets that number.
  std::vector<zmq::socket_t> others;
  while (others.size() < 20 && bus::cookie_of(socket.fd) == 0) others.push_back(connect());
  ASSERT_NE(bus::cookie_of(socket.fd), 0U);
  auto last = receive();
  ASSERT_EQ(bus::descriptor_of(last), socket.fd);
  EXPECT_TRUE(admit("trainer.next", last));
  auto next = connect();
  send(next);
  auto of_next = receive();
  EXPECT_TRUE(admit("trainer.next", of_next)) << why_;
}

}  // namespace
}  // namespace splatbus::bus_service

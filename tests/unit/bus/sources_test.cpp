#include "bus/sources.h"

#include <gtest/gtest.h>

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

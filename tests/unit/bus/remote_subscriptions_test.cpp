#include "bus/remote_subscriptions.h"

#include <fmt/format.h>
#include <gmock/gmock.h>

#include <zmq.hpp>

#include "bus_fixture.h"

namespace splatbus::bus_service {
namespace {

/// The broker's XPUB, with RemoteSubscriptions behind it.
class RemoteSubscriptionsTest : public testing::Test {
 protected:
  RemoteSubscriptionsTest() {
    xpub_.set(zmq::sockopt::xpub_verboser, true);
    xpub_.set(zmq::sockopt::rcvtimeo, 5000);
    xpub_.bind("tcp://127.0.0.1:*");
  }
  zmq::socket_t connect() {
    zmq::socket_t reader(zmq_, zmq::socket_type::sub);
    reader.set(zmq::sockopt::linger, 0);
    reader.set(zmq::sockopt::sndhwm, 0);  // of subscriptions
    reader.connect(xpub_.get(zmq::sockopt::last_endpoint));
    return reader;
  }
  /// Takes in what the next event says.
  bool note() {
    zmq::message_t event;
    EXPECT_TRUE(xpub_.recv(event).has_value());
    const std::string text = event.to_string();
    if (text[0] == 1) return subscriptions_.begin(event, text.substr(1));
    subscriptions_.end(event, text.substr(1));
    return true;
  }
  bool subscribe(zmq::socket_t& reader, const std::string& prefix) {
    reader.set(zmq::sockopt::subscribe, prefix);
    return note();
  }
  void unsubscribe(zmq::socket_t& reader, const std::string& prefix) {
    reader.set(zmq::sockopt::unsubscribe, prefix);
    note();
  }

  zmq::context_t zmq_;
  zmq::socket_t xpub_{zmq_, zmq::socket_type::xpub};
  RemoteSubscriptions subscriptions_;
};

TEST_F(RemoteSubscriptionsTest, OneWhoLeavesATopicLeavesItForHimself) {
  auto one = connect(), other = connect();
  EXPECT_TRUE(subscribe(one, "model/"));
  EXPECT_TRUE(subscribe(other, "model/"));
  EXPECT_TRUE(subscribe(other, "scene/state"));
  EXPECT_EQ(subscriptions_.readers_of("model/published").size(), 2U);
  EXPECT_EQ(subscriptions_.readers_of("scene/state").size(), 1U);
  EXPECT_FALSE(subscriptions_.wants("model"));
  EXPECT_FALSE(subscriptions_.wants("scene/light_depth"));
  unsubscribe(one, "model/");
  EXPECT_TRUE(subscriptions_.wants("model/published"));
  unsubscribe(other, "model/");
  EXPECT_FALSE(subscriptions_.wants("model/published"));
  EXPECT_TRUE(subscriptions_.wants("scene/state"));
}

TEST_F(RemoteSubscriptionsTest, WhoIsGoneWantsNothing) {
  auto one = connect(), other = connect();
  EXPECT_TRUE(subscribe(one, ""));
  EXPECT_TRUE(subscribe(other, "scene/"));
  EXPECT_TRUE(subscriptions_.wants("model/published"));
  one.close();
  EXPECT_TRUE(bus_test::eventually([&] {
    subscriptions_.forget_closed();
    return !subscriptions_.wants("model/published");
  }));
  EXPECT_TRUE(subscriptions_.wants("scene/state"));
}

// The number of its descriptor is another's soon.
TEST_F(RemoteSubscriptionsTest, WhoIsGoneHasNoDescriptor) {
  auto one = connect();
  EXPECT_TRUE(subscribe(one, "model/"));
  EXPECT_EQ(subscriptions_.readers_of("model/published").size(), 1U);
  one.close();
  EXPECT_TRUE(bus_test::eventually([&] {
    zmq::message_t event;  // libzmq closes it when the socket is used
    static_cast<void>(xpub_.recv(event, zmq::recv_flags::dontwait));
    return subscriptions_.readers_of("model/published").empty();
  }));
  EXPECT_TRUE(subscriptions_.wants("model/published")) << "nobody has said so yet";
}

TEST_F(RemoteSubscriptionsTest, AReaderOfTooMuchIsBoundedAndNobodyElse) {
  auto greedy = connect(), good = connect();
  for (std::size_t i = 0; i < RemoteSubscriptions::kOfReader; ++i) {
    ASSERT_TRUE(subscribe(greedy, fmt::format("many/{}/", i)));
  }
  EXPECT_FALSE(subscribe(greedy, "one/more"));
  EXPECT_FALSE(subscriptions_.wants("one/more"));
  EXPECT_TRUE(subscribe(good, "one/more"));
  EXPECT_TRUE(subscriptions_.wants("one/more"));
  unsubscribe(greedy, "many/7/");
  EXPECT_FALSE(subscriptions_.wants("many/7/x"));
  EXPECT_TRUE(subscribe(greedy, "another"));
  EXPECT_TRUE(subscriptions_.wants("one/more/again"));
}

}  // namespace
}  // namespace splatbus::bus_service

#include "bus_fixture.h"

namespace splatbus::bus_test {
namespace {

class PublishSubscribe : public BusTest {};

// Reads numbers until the wanted one comes.
bool read_until(bus::Subscriber& subscriber, std::uint64_t wanted) {
  while (const auto number = receive_number(subscriber)) {
    if (*number == wanted) return true;
  }
  return false;
}

TEST_F(PublishSubscribe, DeliversWhatWasPublishedInOrder) {
  const auto context = connect("maker");
  bus::Publisher publisher(context, "viewer/probe");
  bus::Subscriber subscriber(connect("reader"), {"viewer/probe"});
  meet(publisher, subscriber);
  const auto first = publisher.sequence() + 1;
  for (std::uint64_t i = 1; i <= 100; ++i) publish_number(publisher, i);
  for (std::uint64_t i = 1; i <= 100; ++i) {
    const auto message = subscriber.receive(patience);
    ASSERT_TRUE(message.has_value());
    EXPECT_EQ(number_of(*message), i);
    EXPECT_EQ(message->topic(), "viewer/probe");
    EXPECT_EQ(message->header().source()->str(), "maker");
    EXPECT_EQ(message->header().epoch(), context->epoch());
    EXPECT_EQ(message->header().sequence(), first + i - 1);
    EXPECT_LE(message->header().publish_ns(), bus::now_ns());
    EXPECT_FALSE(message->header().resent());
  }
  EXPECT_FALSE(subscriber.receive(0ms).has_value());
  EXPECT_EQ(subscriber.lost(), 0u);
}

TEST_F(PublishSubscribe, TwoPublishersOfATopicShareItsSequence) {
  const auto context = connect("maker");
  bus::Publisher first(context, "viewer/probe");
  bus::Publisher second(context, "viewer/probe");
  bus::Subscriber subscriber(connect("reader"), {"viewer/probe"});
  meet(first, subscriber);
  for (int i = 0; i < 10; ++i) publish_number(i % 2 == 0 ? first : second, 1);
  for (int i = 0; i < 10; ++i) ASSERT_TRUE(subscriber.receive(patience).has_value());
  EXPECT_EQ(subscriber.lost(), 0u);
  EXPECT_EQ(second.sequence(), first.sequence() + 1);
}

TEST_F(PublishSubscribe, ExactNamesDoNotMatchLongerOnesAndPrefixesDo) {
  const auto context = connect("maker");
  bus::Publisher other(context, "viewer/probe2");
  bus::Publisher publisher(context, "viewer/probe");
  bus::Subscriber exact(connect("reader"), {"viewer/probe"});
  bus::Subscriber prefix(connect("reader-2"), {"viewer/*"});
  meet(publisher, exact);
  meet(publisher, prefix);
  publish_number(other, 1);
  publish_number(publisher, 2);
  EXPECT_TRUE(read_until(exact, 2));
  EXPECT_EQ(prefix.receive(patience)->topic(), "viewer/probe2");
  EXPECT_EQ(prefix.receive(patience)->topic(), "viewer/probe");
}

TEST_F(PublishSubscribe, LatchedMessagesReachALateSubscriberOnceAKey) {
  const auto context = connect("maker");
  bus::Publisher publisher(context, "grid/state");
  bus::Subscriber witness(connect("witness"), {"grid/state"});
  publish_number(publisher, 1, true, "a");
  publish_number(publisher, 2, true, "b");
  publish_number(publisher, 3, true, "a");
  ASSERT_TRUE(read_until(witness, 3));
  bus::Subscriber late(connect("reader"), {"grid/state"});
  auto message = late.receive(patience);
  ASSERT_TRUE(message.has_value());
  EXPECT_EQ(number_of(*message), 2u);
  EXPECT_TRUE(message->header().resent());
  message = late.receive(patience);
  ASSERT_TRUE(message.has_value());
  EXPECT_EQ(number_of(*message), 3u);
  // A third subscriber makes the broker send them again, to everybody; those who have them do not see that.
  bus::Subscriber later(connect("reader-2"), {"grid/state"});
  EXPECT_EQ(receive_number(later), 2u);
  EXPECT_EQ(receive_number(later), 3u);
  publish_number(publisher, 4, true, "a");
  EXPECT_EQ(receive_number(late), 4u);
  EXPECT_EQ(receive_number(witness), 4u);
  EXPECT_EQ(late.lost(), 0u);
  EXPECT_EQ(witness.lost(), 0u);
}

TEST_F(PublishSubscribe, LatchedMessageOutlivesItsPublisher) {
  {
    bus::Publisher publisher(connect("maker"), "grid/state");
    publish_number(publisher, 5, true);
  }
  bus::Subscriber late(connect("reader"), {"grid/state"});
  EXPECT_EQ(receive_number(late), 5u);
}

TEST_F(PublishSubscribe, ARestartedSourceReplacesItsLatchedMessage) {
  bus::Subscriber witness(connect("witness"), {"grid/state"});
  {
    bus::Publisher publisher(connect("maker"), "grid/state");
    for (int i = 0; i < 5; ++i) publish_number(publisher, 5, true);
    ASSERT_TRUE(read_until(witness, 5));
  }
  bus::Publisher publisher(connect("maker"), "grid/state");
  publish_number(publisher, 6, true);  // its sequence is lower, its epoch later
  ASSERT_TRUE(read_until(witness, 6));
  bus::Subscriber late(connect("reader"), {"grid/state"});
  EXPECT_EQ(receive_number(late), 6u);
}

TEST_F(PublishSubscribe, LastMessageOfAnEndingPublisherLeaves) {
  bus::Subscriber subscriber(connect("reader"), {"viewer/probe"});
  {
    bus::Publisher publisher(connect("maker"), "viewer/probe");
    meet(publisher, subscriber);
    publish_number(publisher, 9);
  }
  EXPECT_EQ(receive_number(subscriber), 9u);
}

TEST_F(PublishSubscribe, NewestOfEachTopicSourceAndKeyIsKept) {
  const auto context = connect("maker");
  bus::Publisher publisher(context, "viewer/probe");
  bus::Publisher other_topic(context, "viewer/probe2");
  bus::Publisher other_source(connect("other"), "viewer/probe");
  bus::Subscriber subscriber(connect("reader"), {"viewer/*"});
  meet(publisher, subscriber);
  meet(other_topic, subscriber);
  meet(other_source, subscriber);
  std::vector<bus::Message> messages;
  const auto send = [&](bus::Publisher& from, std::uint64_t number, const std::string& key) {
    publish_number(from, number, false, key);
    messages.push_back(subscriber.receive(patience).value());
  };
  send(publisher, 1, "left");
  send(publisher, 2, "right");
  send(other_topic, 3, "left");
  send(publisher, 4, "left");
  send(other_source, 5, "left");
  send(publisher, 6, "");
  send(publisher, 7, "");
  std::vector<std::uint64_t> numbers;
  for (const auto& message : bus::keep_newest(std::move(messages))) numbers.push_back(number_of(message));
  EXPECT_EQ(numbers, (std::vector<std::uint64_t>{2, 3, 4, 5, 7}));
}

TEST_F(PublishSubscribe, WaitingForTheSubscriptionKeepsWhatComesMeanwhile) {
  const auto context = connect("maker");
  bus::Publisher latched(context, "grid/state");
  publish_number(latched, 4, true);
  ASSERT_TRUE(context->wait_connected(patience));
  bus::Subscriber subscriber(connect("reader"), {"grid/state", "viewer/probe"});
  ASSERT_TRUE(subscriber.wait_connected(patience));
  bus::Publisher publisher(context, "viewer/probe");
  publish_number(publisher, 5);
  EXPECT_EQ(receive_number(subscriber), 4u);
  EXPECT_EQ(receive_number(subscriber), 5u);
  EXPECT_FALSE(subscriber.receive(0ms).has_value());
  const TemporaryDirectory empty;
  EXPECT_FALSE(bus::Subscriber(bus::Context::create(empty.address(), "reader"), {"a"}).wait_connected(10ms));
}

TEST_F(PublishSubscribe, ReceiveNewestEndsWithTheLast) {
  bus::Publisher publisher(connect("maker"), "viewer/probe");
  bus::Subscriber subscriber(connect("reader"), {"viewer/probe"});
  meet(publisher, subscriber);
  EXPECT_TRUE(subscriber.receive_newest(0ms).empty());
  for (std::uint64_t i = 1; i <= 50; ++i) publish_number(publisher, i);
  std::uint64_t last = 0;
  while (last != 50) {
    const auto newest = subscriber.receive_newest(patience);
    ASSERT_EQ(newest.size(), 1u);
    ASSERT_GT(number_of(newest[0]), last);
    last = number_of(newest[0]);
  }
}

TEST(PublishSubscribeStart, MessagesWaitForTheBroker) {
  const TemporaryDirectory directory;
  const auto context = bus::Context::create(directory.address(), "maker");
  bus::Publisher publisher(context, "viewer/probe");
  bus::Publisher latched(context, "grid/state");
  EXPECT_FALSE(context->wait_connected(0ms));
  publish_number(latched, 1, true);
  publish_number(latched, 2, true);
  publish_number(publisher, 3);
  bus::Subscriber subscriber(bus::Context::create(directory.address(), "reader"), {"viewer/probe", "grid/state"});
  bus_service::Broker broker({.address = directory.address()});
  broker.start();
  EXPECT_TRUE(context->wait_connected(patience));
  EXPECT_EQ(receive_number(subscriber), 2u);  // whether it came live or was held by the broker
}

}  // namespace
}  // namespace splatbus::bus_test

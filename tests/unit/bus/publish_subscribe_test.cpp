#include <gmock/gmock.h>

#include <algorithm>
#include <stdexcept>

#include "bus_fixture.h"
#include "fake_broker.h"
#include "log_capture.h"

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
  NumberPublisher publisher(context, "viewer/probe");
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
  NumberPublisher first(context, "viewer/probe");
  NumberPublisher second(context, "viewer/probe");
  bus::Subscriber subscriber(connect("reader"), {"viewer/probe"});
  meet(first, subscriber);
  for (int i = 0; i < 10; ++i) publish_number(i % 2 == 0 ? first : second, 1);
  for (int i = 0; i < 10; ++i) ASSERT_TRUE(subscriber.receive(patience).has_value());
  EXPECT_EQ(subscriber.lost(), 0u);
  EXPECT_EQ(second.sequence(), first.sequence() + 1);
}

TEST_F(PublishSubscribe, ExactNamesDoNotMatchLongerOnesAndPrefixesDo) {
  const auto context = connect("maker");
  NumberPublisher other(context, "viewer/probe2");
  NumberPublisher publisher(context, "viewer/probe");
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
  NumberPublisher publisher(context, "grid/state");
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
    NumberPublisher publisher(connect("maker"), "grid/state");
    publish_number(publisher, 5, true);
  }
  bus::Subscriber late(connect("reader"), {"grid/state"});
  EXPECT_EQ(receive_number(late), 5u);
}

TEST_F(PublishSubscribe, ARestartedSourceReplacesItsLatchedMessage) {
  bus::Subscriber witness(connect("witness"), {"grid/state"});
  {
    NumberPublisher publisher(connect("maker"), "grid/state");
    for (int i = 0; i < 5; ++i) publish_number(publisher, 5, true);
    ASSERT_TRUE(read_until(witness, 5));
  }
  NumberPublisher publisher(connect("maker"), "grid/state");
  publish_number(publisher, 6, true);  // its sequence is lower, its epoch later
  ASSERT_TRUE(read_until(witness, 6));
  bus::Subscriber late(connect("reader"), {"grid/state"});
  EXPECT_EQ(receive_number(late), 6u);
}

TEST_F(PublishSubscribe, LastMessageOfAnEndingPublisherLeaves) {
  bus::Subscriber subscriber(connect("reader"), {"viewer/probe"});
  {
    NumberPublisher publisher(connect("maker"), "viewer/probe");
    meet(publisher, subscriber);
    publish_number(publisher, 9);
  }
  EXPECT_EQ(receive_number(subscriber), 9u);
}

TEST_F(PublishSubscribe, NewestOfEachTopicSourceAndKeyIsKept) {
  const auto context = connect("maker");
  NumberPublisher publisher(context, "viewer/probe");
  NumberPublisher other_topic(context, "viewer/probe2");
  NumberPublisher other_source(connect("other"), "viewer/probe");
  bus::Subscriber subscriber(connect("reader"), {"viewer/*"});
  meet(publisher, subscriber);
  meet(other_topic, subscriber);
  meet(other_source, subscriber);
  std::vector<bus::Message> messages;
  const auto send = [&](NumberPublisher& from, std::uint64_t number, const std::string& key) {
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
  NumberPublisher latched(context, "grid/state");
  publish_number(latched, 4, true);
  ASSERT_TRUE(context->wait_connected(patience));
  bus::Subscriber subscriber(connect("reader"), {"grid/state", "viewer/probe"});
  ASSERT_TRUE(subscriber.wait_connected(patience));
  NumberPublisher publisher(context, "viewer/probe");
  publish_number(publisher, 5);
  EXPECT_EQ(receive_number(subscriber), 4u);
  EXPECT_EQ(receive_number(subscriber), 5u);
  EXPECT_FALSE(subscriber.receive(0ms).has_value());
  const TemporaryDirectory empty;
  EXPECT_FALSE(bus::Subscriber(bus::Context::create(empty.address(), "reader"), {"a"}).wait_connected(10ms));
}

TEST_F(PublishSubscribe, ReceiveNewestEndsWithTheLast) {
  NumberPublisher publisher(connect("maker"), "viewer/probe");
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
  NumberPublisher publisher(context, "viewer/probe");
  NumberPublisher latched(context, "grid/state");
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

TEST_F(PublishSubscribe, HandlersGetVerifiedRootsAndTheRestIsRefused) {
  const auto context = connect("maker");
  NumberPublisher publisher(context, "viewer/probe");
  std::vector<std::uint64_t> numbers, poses;
  bus::Subscriber subscriber(connect("reader"));
  subscriber
      .on(topics::kViewerProbe,
          [&](const wire::ViewerProbe& probe, const bus::Message& message) {
            EXPECT_EQ(message.header().source()->str(), "maker");
            numbers.push_back(probe.probe_id());
            if (probe.probe_id() == 13) throw std::runtime_error("thirteen");
          })
      .on(topics::kViewerPose,
          [&](const wire::ViewerPose&, const bus::Message& message) { poses.push_back(message.header().sequence()); });
  meet(publisher, subscriber);
  const auto probe = [](auto& builder, auto header) {
    const wire::Camera camera;
    return wire::CreateViewerProbe(builder, header, 99, &camera);
  };
  publish_number(publisher, 12);
  publisher.publish(Topic<wire::ViewerProbe>{"viewer/probe", false, "ViewerProbe/99"}, probe);
  publisher.publish(Topic<wire::ViewerProbe>{"viewer/pose", false, kSchema<wire::ViewerPose>}, probe);
  publish_number(publisher, 13);
  publisher.publish(Topic<wire::ViewerProbe>{"viewer/probe2"}, probe);  // a longer name, subscribed to by nobody
  publish_number(publisher, 14);
  std::size_t taken = 0;
  while (taken < 5) {
    const std::size_t more = subscriber.dispatch_all(patience, 2);
    ASSERT_GT(more, 0u);
    ASSERT_LE(more, 2u);
    taken += more;
  }
  EXPECT_EQ(numbers, (std::vector<std::uint64_t>{12, 13, 14}));
  EXPECT_TRUE(poses.empty());
  EXPECT_EQ(subscriber.refused(), 3u);
  EXPECT_EQ(subscriber.dispatch_all(0ms), 0u);
}

TEST_F(PublishSubscribe, RefusalsOfASourceAreLoggedOnceASecond) {
  NumberPublisher publisher(connect("maker"), "viewer/probe"), other(connect("other"), "viewer/probe");
  bus::Subscriber subscriber(connect("reader"));
  subscriber.on(topics::kViewerProbe,
                [](const wire::ViewerProbe&, const bus::Message&) { throw std::runtime_error("never good enough"); });
  meet(publisher, subscriber);
  meet(other, subscriber);
  std::string text;
  {
    const LogCapture log;
    for (int i = 0; i < 50; ++i) {
      publish_number(publisher, 1);
      publish_number(other, 1);
    }
    for (std::size_t taken = 0; taken < 100;) taken += subscriber.dispatch_all(patience);
    text = log.text();
  }
  EXPECT_EQ(subscriber.refused(), 100u);
  EXPECT_THAT(text, testing::HasSubstr("viewer/probe from maker"));
  EXPECT_THAT(text, testing::HasSubstr("viewer/probe from other"));
  EXPECT_THAT(text, testing::HasSubstr("never good enough"));
  EXPECT_LT(std::count(text.begin(), text.end(), '\n'), 50);
}

/// Under many names as under one.
TEST_F(PublishSubscribe, RefusalsOfAllSourcesAreBoundedTogether) {
  constexpr int kNames = 60;
  bus::Subscriber subscriber(connect("reader"));
  subscriber.on(topics::kViewerProbe,
                [](const wire::ViewerProbe&, const bus::Message&) { throw std::runtime_error("never good enough"); });
  ASSERT_TRUE(subscriber.wait_connected(patience));
  RawPublisher publisher(directory_.address().publish_endpoint());
  const LogCapture log;
  for (int i = 0; i < kNames; ++i) {
    flatbuffers::FlatBufferBuilder builder;
    const auto header = wire::CreateHeaderDirect(builder, std::string(topics::kViewerProbe.schema).c_str(),
                                                 ("maker-" + std::to_string(i)).c_str(), 1, 1);
    const wire::Camera camera;
    builder.Finish(wire::CreateViewerProbe(builder, header, 1, &camera));
    publisher.send({"viewer/probe", {reinterpret_cast<const char*>(builder.GetBufferPointer()), builder.GetSize()}});
  }
  ASSERT_TRUE(eventually([&] {
    subscriber.dispatch_all(0ms);
    return subscriber.refused() == kNames;
  }));
  EXPECT_GT(log.lines(), 0);
  EXPECT_LT(log.lines(), kNames);
}

}  // namespace
}  // namespace splatbus::bus_test

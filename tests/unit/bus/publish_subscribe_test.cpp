#include "bus_fixture.h"

namespace splatbus::bus_test {
namespace {

class PublishSubscribe : public BusTest {};

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

TEST_F(PublishSubscribe, LatchedMessageReachesALateSubscriber) {
  const auto context = connect("maker");
  bus::Publisher publisher(context, "grid/state");
  publish_number(publisher, 41, true);
  publish_number(publisher, 42, true);
  ASSERT_TRUE(eventually([&] { return broker_->statistics().held >= 2; }));  // the broker's own and this
  bus::Subscriber late(connect("reader"), {"grid/state"});
  const auto message = late.receive(patience);
  ASSERT_TRUE(message.has_value());
  EXPECT_EQ(number_of(*message), 42u);
  EXPECT_TRUE(message->header().resent());
}

}  // namespace
}  // namespace splatbus::bus_test

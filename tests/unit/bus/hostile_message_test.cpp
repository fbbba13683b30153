#include <gmock/gmock.h>

#include <random>

#include "bus/error.h"
#include "bus_fixture.h"
#include "fake_broker.h"

namespace splatbus::bus_test {
namespace {

using testing::HasSubstr;
using testing::ThrowsMessage;

/// A subscriber that listens to a broker of the test's own.
class HostileMessage : public testing::Test {
 protected:
  HostileMessage()
      : broker_(directory_.address()),
        subscriber_(bus::Context::create(directory_.address(), "reader"), {"viewer/probe"}) {
    broker_.await_subscription();
  }

  void send(const std::string& body) { broker_.send({"viewer/probe", body}); }

  std::optional<bus::Message> receive_tensor(const RawTensor& tensor, const std::string& payload) {
    broker_.send({"viewer/probe", probe_body(++sequence_, 1, {tensor}), payload});
    return subscriber_.receive(patience);
  }

  TemporaryDirectory directory_;
  FakeBroker broker_;
  bus::Subscriber subscriber_;
  std::uint64_t sequence_ = 0;
};

RawTensor inline_tensor(std::uint64_t offset, std::uint64_t bytes, std::vector<std::uint32_t> shape,
                        wire::ElementType type = wire::ElementType::F32) {
  return {"values", wire::Span(0, 0, offset, bytes, wire::Storage::Inline), std::move(shape), type};
}

TEST_F(HostileMessage, GapsInTheSequenceAreCounted) {
  for (const std::uint64_t sequence : {1, 2, 5, 6, 10}) send(probe_body(sequence, sequence));
  for (const std::uint64_t sequence : {1, 2, 5, 6, 10}) EXPECT_EQ(receive_number(subscriber_), sequence);
  EXPECT_EQ(subscriber_.lost(), 5u);
}

TEST_F(HostileMessage, RepeatedLatchedMessagesAreDropped) {
  for (const std::uint64_t sequence : {1, 2, 1, 2, 3}) {
    send(probe_body(sequence, sequence, {}, "ViewerProbe/1", true, "key"));
  }
  for (const std::uint64_t sequence : {1, 2, 3}) EXPECT_EQ(receive_number(subscriber_), sequence);
  EXPECT_FALSE(subscriber_.receive(0ms).has_value());
  EXPECT_EQ(subscriber_.lost(), 0u);
}

TEST_F(HostileMessage, WrongNumbersOfFramesAreCountedAndSkipped) {
  broker_.send({"viewer/probe"});
  broker_.send({"viewer/probe", probe_body(1, 1), "payload", "more"});
  broker_.send({"viewer/probe" + std::string(200, 'x'), probe_body(1, 1)});
  broker_.send({"viewer/probe", ""});
  send(probe_body(1, 77));
  EXPECT_EQ(receive_number(subscriber_), 77u);
  EXPECT_EQ(subscriber_.malformed(), 4u);
}

TEST_F(HostileMessage, EveryTruncationIsSkippedOrRefused) {
  const auto body = probe_body(1, 77, {inline_tensor(0, 8, {2})});
  for (std::size_t length = 0; length < body.size(); ++length) send(body.substr(0, length));
  send(probe_body(1, 78));
  std::size_t refused = 0;
  std::size_t whole = 0;
  while (const auto message = subscriber_.receive(patience)) {
    try {
      if (number_of(*message) == 78) break;
      ++whole;  // only padding was cut off
    } catch (const bus::Error&) {
      ++refused;  // the header survived, the rest did not
    }
  }
  EXPECT_EQ(refused + whole + subscriber_.malformed(), body.size());
  EXPECT_LT(whole, 8u);
}

TEST_F(HostileMessage, RandomBytesAreSkipped) {
  std::mt19937_64 random(1);
  for (int i = 0; i < 500; ++i) {
    std::string bytes(random() % 300, '\0');
    for (char& c : bytes) c = static_cast<char>(random());
    send(bytes);
  }
  send(probe_body(1, 78));
  EXPECT_EQ(receive_number(subscriber_), 78u);
  EXPECT_EQ(subscriber_.malformed(), 500u);
}

TEST_F(HostileMessage, WrongSchemaIsNamed) {
  send(probe_body(3, 1, {}, "EngineFrame/1"));
  const auto message = subscriber_.receive(patience);
  ASSERT_TRUE(message.has_value());
  EXPECT_THAT([&] { (void)number_of(*message); },
              ThrowsMessage<bus::Error>(testing::AllOf(HasSubstr("viewer/probe"), HasSubstr("maker"),
                                                       HasSubstr("sequence 3"), HasSubstr("EngineFrame/1"))));
  EXPECT_FALSE(bus::guarded(*message, [&] { (void)number_of(*message); }));
  EXPECT_TRUE(bus::guarded(*message, [] {}));
}

TEST_F(HostileMessage, GoodInlineTensorIsRead) {
  const float values[] = {1, 2};
  const auto message = receive_tensor(inline_tensor(0, 8, {2}), std::string(reinterpret_cast<const char*>(values), 8));
  EXPECT_EQ(message->tensor("values", bus::ElementType::F32, {2})->as<float>()[1], 2.0F);
  EXPECT_FALSE(message->tensor("other").has_value());
  EXPECT_THROW((void)message->tensor("values", bus::ElementType::U32, {2}), bus::Error);
  EXPECT_THROW((void)message->tensor("values", bus::ElementType::F32, {3}), bus::Error);
  EXPECT_THROW((void)message->tensor("values", bus::ElementType::F32, {2, 1}), bus::Error);
  EXPECT_THROW((void)message->tensor("values")->as<std::uint32_t>(), bus::Error);
}

TEST_F(HostileMessage, LyingTensorsAreRefusedByName) {
  const std::string payload(16, '\0');
  constexpr auto huge = std::uint64_t{1} << 63;
  const RawTensor lies[] = {
      inline_tensor(0, 20, {5}),                          // beyond the frame
      inline_tensor(12, 8, {2}),                          // partly beyond
      inline_tensor(UINT64_MAX - 3, 8, {2}),              // offset + bytes wraps
      inline_tensor(huge, 8, {2}),                        //
      inline_tensor(0, 8, {3}),                           // shape and bytes differ
      inline_tensor(0, 0, {65536, 65536, 65536, 65536}),  // the product wraps to 0
      inline_tensor(0, huge, {0x80000000U, 0x40000000U}),
      inline_tensor(2, 8, {2}),  // misaligned
      inline_tensor(0, 8, {2}, static_cast<wire::ElementType>(99)),
      inline_tensor(0, 4, {1, 1, 1, 1, 1, 1, 1, 1, 1}),  // too many axes
      {"values", wire::Span(0, 0, 0, 8, static_cast<wire::Storage>(7)), {2}, wire::ElementType::F32},
  };
  for (const auto& lie : lies) {
    const auto message = receive_tensor(lie, payload);
    ASSERT_TRUE(message.has_value());
    EXPECT_THAT([&] { (void)message->tensor("values"); },
                ThrowsMessage<bus::Error>(testing::AllOf(HasSubstr("values"), HasSubstr("viewer/probe"))));
  }
  EXPECT_EQ(subscriber_.malformed(), 0u);
}

TEST_F(HostileMessage, InlineTensorWithoutPayloadIsRefused) {
  broker_.send({"viewer/probe", probe_body(1, 1, {inline_tensor(0, 8, {2})})});
  const auto message = subscriber_.receive(patience);
  EXPECT_THROW((void)message->tensor("values"), bus::Error);
}

TEST_F(HostileMessage, SlabThatCannotBeReachedIsALostFrame) {
  const auto message =
      receive_tensor({"values", wire::Span(5, 2, 0, 8, wire::Storage::Slab), {2}, wire::ElementType::F32}, "");
  EXPECT_FALSE(message->tensor("values").has_value());
}

class HostileToBroker : public BusTest {};

TEST_F(HostileToBroker, GarbageGoesNoFurtherAndNothingElseIsDisturbed) {
  NumberPublisher publisher(connect("maker"), "viewer/probe");
  bus::Subscriber subscriber(connect("reader"), {"viewer/probe"});
  meet(publisher, subscriber);
  RawPublisher raw(directory_.address().publish_endpoint());
  for (int i = 0; i < 100; ++i) raw.send({"viewer/probe", std::string(i, '\xff')});
  raw.send({"viewer/probe"});
  // A heartbeat that is none.
  raw.send({"sys/heartbeat", probe_body(1, 1)});
  EXPECT_TRUE(eventually([&] { return broker_->statistics().malformed == 102; })) << broker_->statistics().malformed;
  publish_number(publisher, 5);
  EXPECT_EQ(receive_number(subscriber), 5u);
  EXPECT_EQ(subscriber.malformed(), 0u);
}

}  // namespace
}  // namespace splatbus::bus_test

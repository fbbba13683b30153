// What peers of a bus do to it and to each other: over tcp by hand, on this machine by forged messages.
#include <gmock/gmock.h>
#include <unistd.h>

#include <atomic>
#include <thread>
#include <vector>

#include "../unit/bus/bus_fixture.h"
#include "../unit/bus/fake_broker.h"
#include "budgets.h"
#include "bus/clock.h"
#include "bus/error.h"
#include "bus/frames.h"
#include "many_bytes.h"
#include "raw_zmtp.h"

namespace splatbus::hostile {
namespace {

using bus_test::eventually;
using bus_test::number_of;
using bus_test::NumberPublisher;
using bus_test::patience;
using bus_test::publish_number;
using bus_test::RawPublisher;
using bus_test::receive_number;
using testing::HasSubstr;
using namespace std::chrono_literals;

constexpr std::uint64_t kForever = ~std::uint64_t{0};

std::string forged(const std::string& source, std::uint64_t epoch, std::uint64_t number,
                   const std::string& key = "key") {
  flatbuffers::FlatBufferBuilder builder;
  builder.ForceDefaults(true);
  const auto header = wire::CreateHeaderDirect(builder, "ViewerProbe/1", source.c_str(), kForever - 1, epoch, 0,
                                               INT64_MAX, 0, true, key.c_str());
  const wire::Camera camera;
  builder.Finish(wire::CreateViewerProbe(builder, header, number, &camera));
  return {reinterpret_cast<const char*>(builder.GetBufferPointer()), builder.GetSize()};
}

class HostileBus : public bus_test::BusTest {
 protected:
  /// What the broker tells somebody who comes now.
  std::optional<std::uint64_t> held(const std::string& topic) {
    bus::Subscriber late(connect("late"), {topic});
    return receive_number(late);
  }
  [[nodiscard]] std::string writers() const { return broker_->tcp_address()->publish_endpoint(); }
  [[nodiscard]] std::string readers() const { return broker_->tcp_address()->subscribe_endpoint(); }
};

TEST_F(HostileBus, AForgedEpochSilencesNobody) {
  NumberPublisher light(connect("engine"), "scene/held");
  bus::Subscriber reader(connect("reader"), {"scene/held"});
  meet(light, reader);
  publish_number(light, 1, true, "key");
  ASSERT_EQ(receive_number(reader), 1u);
  RawPublisher near(directory_.address().publish_endpoint()), far(writers());
  const auto before = broker_->statistics().malformed;
  near.send({"scene/held", forged("engine", kForever, 666)});
  near.send({"scene/held", forged("engine", static_cast<std::uint64_t>(bus::now_ns()), 667)});
  near.send({"scene/held", forged("bus", 1, 668)});
  far.send({"scene/held", forged("engine", kForever, 669)});
  ASSERT_TRUE(eventually([&] { return broker_->statistics().malformed == before + 4; }));
  // Nor does another name help one from elsewhere to what is said here.
  const auto relayed = broker_->statistics().relayed;
  far.send({"scene/held", forged("stranger", kForever, 670)});
  far.send({"viewer/probe", forged("stranger", kForever, 671)});
  ASSERT_TRUE(eventually([&] { return broker_->statistics().relayed > relayed; }));
  publish_number(light, 2, true, "key");
  EXPECT_EQ(receive_number(reader), 2u);
  EXPECT_EQ(held("scene/held"), 2u);
}

TEST_F(HostileBus, ANameTakenFromElsewhereIsGivenBackToWhoComesHere) {
  RawPublisher far(writers());
  const auto relayed = broker_->statistics().relayed;
  far.send({"scene/held", forged("engine", kForever, 666)});
  ASSERT_TRUE(eventually([&] { return held("scene/held") == 666u; })) << relayed;
  NumberPublisher light(connect("engine"), "scene/held");
  ASSERT_TRUE(light.context()->wait_connected(patience));
  publish_number(light, 1, true, "key");
  EXPECT_TRUE(eventually([&] { return held("scene/held") == 1u; }));
  far.send({"scene/held", forged("engine", kForever, 667)});
  publish_number(light, 2, true, "key");
  EXPECT_TRUE(eventually([&] { return held("scene/held") == 2u; }));
}

TEST_F(HostileBus, ARestartedSourceIsHeardAtOnce) {
  for (std::uint64_t life = 1; life <= 5; ++life) {
    NumberPublisher light(connect("engine"), "scene/held");
    ASSERT_TRUE(light.context()->wait_connected(patience));
    publish_number(light, life, true, "key");
    EXPECT_TRUE(eventually([&] { return held("scene/held") == life; }, 3s)) << life;
  }
}

TEST_F(HostileBus, ASourceThatComesBackHasItsNameAgain) {
  RawPublisher far(writers());
  for (std::uint64_t life = 1; life <= 5; ++life) {
    // Mostly with the descriptor that it had before.
    NumberPublisher light(connect("engine"), "scene/held");
    ASSERT_TRUE(light.context()->wait_connected(patience));
    publish_number(light, life, true, "key");
    ASSERT_TRUE(eventually([&] { return held("scene/held") == life; }));
    const auto before = broker_->statistics().malformed;
    far.send({"scene/held", forged("engine", kForever, 666)});
    EXPECT_TRUE(eventually([&] { return broker_->statistics().malformed > before; }, 3s)) << life;
    EXPECT_EQ(held("scene/held"), life);
  }
}

TEST_F(HostileBus, AMessageWithoutAnEndIsEnded) {
  const std::size_t before = resident_bytes(::getpid());
  RawZmtp raw(writers());
  ASSERT_TRUE(raw.handshake("XPUB"));
  const std::string part(kMiB, 'x');
  std::size_t sent = 0;
  while (sent < 1000 * kMiB && raw.send_frame(part, true)) sent += part.size();
  EXPECT_LT(sent, 300 * kMiB);
  EXPECT_TRUE(raw.closed_within(1s));
  EXPECT_LT(resident_bytes(::getpid()), before + 64 * kMiB);
}

TEST_F(HostileBus, SubscriptionsWithoutEndAreEnded) {
  const std::size_t before = resident_bytes(::getpid());
  RawZmtp raw(readers());
  ASSERT_TRUE(raw.handshake("SUB"));
  int sent = 0;
  while (sent < 200'000 && raw.send_frame("\x01" + std::string(100, 'a') + std::to_string(sent), false)) ++sent;
  EXPECT_LT(sent, 200'000);
  EXPECT_LT(resident_bytes(::getpid()), before + 64 * kMiB);
  RawZmtp other(readers());
  ASSERT_TRUE(other.handshake("SUB"));
  ASSERT_TRUE(other.send_frame_head(std::size_t{1} << 29, false));
  EXPECT_TRUE(other.closed_within(2s));
}

// As of the streamer's endpoint.
TEST_F(HostileBus, APingBehindManySubscriptionsAndAResetEndNothing) {
  for (int round = 0; round < 30; ++round) {
    RawZmtp reader(readers());
    ASSERT_TRUE(reader.handshake("SUB"));
    send_messages_and_pings(reader, "\x01a");
    reader.reset();
  }
  NumberPublisher publisher(connect("engine"), "viewer/probe");
  bus::Subscriber far(connect_tcp("far"), {"viewer/probe"});
  meet(publisher, far);
}

TEST_F(HostileBus, ASubscriptionToWhatIsNoTopicEndsTheConnection) {
  RawZmtp reader(readers());
  ASSERT_TRUE(reader.handshake("SUB"));
  ASSERT_TRUE(reader.send_frame("\x01" + std::string(bus::max_topic_bytes + 1, 'a'), false));
  EXPECT_TRUE(reader.closed_within(10s));
}

TEST_F(HostileBus, AReaderThatReadsNothingCostsABoundedQueue) {
  broker_.reset();
  auto bounded = options();
  bounded.max_remote_bytes = 48 * kMiB;
  broker_ = std::make_unique<bus_service::Broker>(bounded);
  broker_->start();
  ManyBytes model(connect("trainer"), "model/held");
  const std::size_t before = resident_bytes(::getpid());
  RawZmtp raw(readers());
  ASSERT_TRUE(raw.handshake("SUB"));
  ASSERT_TRUE(raw.send_frame("\x01model/", false));
  ASSERT_TRUE(eventually([&] { return broker_->statistics().inline_dropped >= 25; }));
  EXPECT_LT(resident_bytes(::getpid()), before + 100 * kMiB) << "two slots of the slab, and 48 MiB";
  EXPECT_LT(broker_->statistics().inlined, 8u) << "what nobody takes is not copied";
  // Nor does it keep others from reading: it is closed, and they go on.
  bus::Subscriber good(connect_tcp("good"), {"model/held"});
  EXPECT_TRUE(raw.closed_within(1ms) || eventually([&] { return good.receive(20ms).has_value(); }, 15s));
  EXPECT_TRUE(good.receive(patience).has_value());
}

TEST_F(HostileBus, WhoSubscribesAgainAndAgainIsToldAFewTimesASecond) {
  ManyBytes model(connect("trainer"), "model/held");
  NumberPublisher light(connect("engine"), "scene/held");
  ASSERT_TRUE(light.context()->wait_connected(patience));
  for (int i = 0; i < 50; ++i) publish_number(light, 1, true, std::to_string(i));
  RawZmtp raw(readers());
  ASSERT_TRUE(raw.handshake("SUB"));
  std::atomic<std::size_t> received = 0;
  std::jthread reader([&](const std::stop_token& stop) {
    while (!stop.stop_requested()) received += raw.read_some(65536, 50ms).size();
  });
  const auto begin = std::chrono::steady_clock::now();
  int rounds = 0;
  while (std::chrono::steady_clock::now() - begin < 1s && raw.send_frame("\x01scene/", false)) {
    raw.send_frame(std::string("\0scene/", 7), false);
    ++rounds;
    if (rounds % 20 == 0) std::this_thread::sleep_for(20ms);
  }
  reader.request_stop();
  reader.join();
  EXPECT_GT(rounds, 100);
  // 50 messages of 300 bytes, 8 at once and 4 times a second.
  EXPECT_LT(received, 16 * 50 * 400U);
}

TEST_F(HostileBus, AMessageThatCannotBeHeldDrivesNobodyOut) {
  broker_.reset();
  auto small = options();
  small.max_held_bytes = kMiB;
  broker_ = std::make_unique<bus_service::Broker>(small);
  broker_->start();
  NumberPublisher light(connect("engine"), "scene/held"), model(connect_tcp("trainer"), "model/held");
  bus::Subscriber reader(connect("reader"), {"model/held"});
  meet(light, reader);
  meet(model, reader);
  publish_number(light, 1, true, "sun");
  ASSERT_EQ(held("scene/held"), 1u);
  const std::vector<float> much(kMiB / 4, 1.0F);
  bus::OutgoingTensor tensor{.name = "values", .shape = {static_cast<std::uint32_t>(much.size())}};
  tensor.inline_data = much.data();
  publish_number(model, 7, true, "", {tensor});
  EXPECT_EQ(receive_number(reader), 7u) << "who is there gets it";
  EXPECT_EQ(held("scene/held"), 1u);
  EXPECT_EQ(broker_->statistics().unheld, 1u);
}

/// A bus over tcp that takes keys.
class KeyedBus : public HostileBus {
 protected:
  KeyedBus() : server_(bus::make_key_pair()), client_(bus::make_key_pair()) {
    broker_.reset();
    bus::write_key_file(folder() + "/server.key", server_);
    bus::write_key_file(folder() + "/client.key", client_);
    auto keyed = options();
    keyed.keys = {.key = folder() + "/server.key", .allowed = folder() + "/allowed", .always = true};
    broker_ = std::make_unique<bus_service::Broker>(keyed);
    allow({});
    broker_->start();
  }
  [[nodiscard]] std::string folder() const { return directory_.path() + "/keys"; }

  void allow(const bus::Rights& rights) {
    std::vector<bus::AllowedKey> keys;
    if (rights.any()) keys.push_back({"client", client_.public_key, rights});
    bus::write_allow_list(folder() + "/allowed", keys);
  }
  std::shared_ptr<bus::Context> connect_with_key(const std::string& source) {
    auto address = *broker_->tcp_address();
    address.key_file = folder() + "/client.key";
    address.server_key = server_.public_key;
    return bus::Context::create(address, source);
  }

  bus::KeyPair server_, client_;
};

TEST_F(KeyedBus, ReadingTakesViewAndPublishingControl) {
  allow({.view = true});
  NumberPublisher here(connect("here"), "viewer/probe");
  const auto far = connect_with_key("far");
  bus::Subscriber reader(far, {"viewer/probe"});
  meet(here, reader);
  publish_number(here, 1);
  EXPECT_EQ(receive_number(reader), 1u);
  EXPECT_FALSE(far->wait_connected(500ms)) << "it may not publish";
  allow({.view = true, .control = true});
  NumberPublisher publisher(connect_with_key("writer"), "viewer/probe");
  EXPECT_TRUE(publisher.context()->wait_connected(patience));
  publish_number(publisher, 2);
  EXPECT_EQ(receive_number(reader), 2u);
  // And back: what is there is closed.
  allow({.control = true});
  EXPECT_TRUE(eventually([&] {
    publish_number(here, 3);
    return !reader.receive(200ms).has_value();
  }));
}

TEST_F(KeyedBus, WithoutAKeyThereIsNothingButARefusal) {
  const auto plain = connect_tcp("plain");
  bus::Subscriber reader(plain, {"sys/liveness"});
  EXPECT_FALSE(reader.wait_connected(500ms));
  EXPECT_FALSE(plain->wait_connected(0ms));
  const std::size_t before = resident_bytes(::getpid());
  RawZmtp raw(writers());
  ASSERT_TRUE(raw.greet("CURVE"));
  const std::string part(kMiB, 'x');
  std::size_t sent = 0;
  while (sent < 1000 * kMiB && raw.send_frame(part, true)) sent += part.size();
  EXPECT_LT(sent, 300 * kMiB);
  EXPECT_LT(resident_bytes(::getpid()), before + 64 * kMiB);
}

TEST(KeysOfABus, AreNeededToGetToAnotherMachine) {
  ::unsetenv("SPLATBUS_KEY");
  ::unsetenv("SPLATBUS_SERVER_KEY");
  EXPECT_THAT([] { bus::Context::create(bus::Address::parse("tcp://192.0.2.1:7000"), "somebody"); },
              testing::ThrowsMessage<bus::Error>(HasSubstr("requires a key")));
  bus_test::TemporaryDirectory directory;
  bus_service::BrokerOptions options{.address = directory.address()};
  options.tcp_host = "*";
  options.keys.key = directory.path() + "/none";
  bus_service::Broker broker(options);
  EXPECT_THAT([&] { broker.start(); }, testing::ThrowsMessage<bus::Error>(HasSubstr("needs a key")));
}

}  // namespace
}  // namespace splatbus::hostile

#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/socket.h>

#include <map>
#include <utility>

#include "bus/connection_watch.h"
#include "bus/error.h"
#include "bus_fixture.h"
#include "fake_broker.h"
#include "slab_helpers.h"
#include "wire/system_generated.h"

namespace splatbus::bus_test {
namespace {

/// Readers and writers over tcp beside those on this machine.
class Tcp : public BusTest {};

std::vector<float> floats_of(const bus::Message& message, const std::string& name) {
  const auto view = message.tensor(name);
  if (!view) return {};
  const auto values = view->as<float>();
  return {values.begin(), values.end()};
}

bus::OutgoingTensor inline_floats(const std::string& name, const std::vector<float>& values) {
  bus::OutgoingTensor tensor;
  tensor.name = name;
  tensor.shape = {static_cast<std::uint32_t>(values.size())};
  tensor.inline_data = values.data();
  return tensor;
}

TEST_F(Tcp, SlabAndInlineTensorsOfOneMessageReachBothKindsOfReader) {
  const auto context = connect("maker");
  NumberPublisher publisher(context, "viewer/probe");
  const auto slab = context->create_slab("frames", 2, 1000);
  bus::Subscriber local(connect("local"), {"viewer/probe"});
  bus::Subscriber remote(connect_tcp("remote"), {"viewer/probe"});
  meet(publisher, local);
  meet(publisher, remote);
  const std::vector<float> extra{9, 8, 7};
  std::vector<float> empty;
  publish_number(publisher, 5, false, "",
                 {inline_floats("extra", extra), write_floats(*slab, {1, 2, 3}), inline_floats("empty", empty)});
  for (auto* subscriber : {&local, &remote}) {
    auto message = subscriber->receive(patience);
    while (message && number_of(*message) != 5) message = subscriber->receive(patience);
    ASSERT_TRUE(message.has_value());
    EXPECT_EQ(floats_of(*message, "values"), (std::vector<float>{1, 2, 3}));
    EXPECT_EQ(floats_of(*message, "extra"), extra);
    ASSERT_TRUE(message->tensor("empty").has_value());
    EXPECT_EQ(message->tensor("empty")->bytes(), 0u);
  }
  EXPECT_GE(broker_->statistics().inlined, 1u);
}

TEST_F(Tcp, APublisherOverTcpSendsItsSlabsInline) {
  const auto context = connect_tcp("far");
  NumberPublisher publisher(context, "viewer/probe");
  const auto slab = context->create_slab("frames", 2, 1000);
  bus::Subscriber local(connect("local"), {"viewer/probe"});
  meet(publisher, local);
  publish_number(publisher, 5, false, "", {write_floats(*slab, {1, 2, 3})});
  const auto message = local.receive(patience);
  ASSERT_TRUE(message.has_value());
  EXPECT_EQ(floats_of(*message, "values"), (std::vector<float>{1, 2, 3}));
  // Handing it on needs no slab either.
  const auto forwarded = message->forward_tensor("values");
  ASSERT_TRUE(forwarded.has_value());
  EXPECT_NE(forwarded->inline_data, nullptr);
  bus::OutgoingTensor foreign = write_floats(*slab, {1});
  foreign.span.mutate_slab(1);
  EXPECT_THROW(publish_number(publisher, 6, false, "", {foreign}), bus::Error);
}

TEST_F(Tcp, WhatWasOverwrittenIsDroppedForTcpReadersAndCounted) {
  const auto context = connect("maker");
  NumberPublisher publisher(context, "viewer/probe");
  const auto slab = context->create_slab("frames", 1, 1000);
  bus::Subscriber remote(connect_tcp("remote"), {"viewer/probe"});
  meet(publisher, remote);
  publish_number(publisher, 4);
  EXPECT_EQ(receive_number(remote), 4u);
  const auto old = write_floats(*slab, {1, 2, 3});
  const auto fresh = write_floats(*slab, {4, 5, 6});
  publish_number(publisher, 5, false, "", {old});
  publish_number(publisher, 6, false, "", {fresh});
  const auto message = remote.receive(patience);
  ASSERT_TRUE(message.has_value());
  EXPECT_EQ(number_of(*message), 6u);
  EXPECT_EQ(floats_of(*message, "values"), (std::vector<float>{4, 5, 6}));
  EXPECT_EQ(remote.lost(), 1u);
  EXPECT_EQ(broker_->statistics().inline_dropped, 1u);
}

TEST_F(Tcp, ASpanOutsideItsSlabIsMalformedForTcpReaders) {
  const auto context = connect("maker");
  NumberPublisher publisher(context, "viewer/probe");
  const auto slab = context->create_slab("frames", 1, 1000);
  bus::Subscriber remote(connect_tcp("remote"), {"viewer/probe"});
  meet(publisher, remote);
  auto lie = write_floats(*slab, {1, 2, 3});
  lie.span.mutate_offset(1 << 20);
  publish_number(publisher, 5, false, "", {lie});
  publish_number(publisher, 6);
  EXPECT_EQ(receive_number(remote), 6u);
  EXPECT_EQ(broker_->statistics().malformed, 1u);
}

TEST_F(Tcp, ASlabTensorFromElsewhereGoesNoFurther) {
  const auto context = connect("maker");
  const auto slab = context->create_slab("frames", 1, 1000);
  RawPublisher raw(broker_->tcp_address()->publish_endpoint());
  const RawTensor stolen{"values", write_floats(*slab, {1}).span, {1}, wire::ElementType::F32};
  raw.send({"viewer/probe", probe_body(1, 1, {stolen})});
  EXPECT_TRUE(eventually([&] { return broker_->statistics().malformed == 1; }));
}

TEST_F(Tcp, LatchedSlabMessageReachesALateTcpReader) {
  const auto context = connect("maker");
  NumberPublisher publisher(context, "grid/state");
  const auto slab = context->create_slab("frames", 1, 1000);
  bus::Subscriber witness(connect("witness"), {"grid/state"});
  publish_number(publisher, 5, true, "", {write_floats(*slab, {1, 2, 3})});
  ASSERT_EQ(receive_number(witness), 5u);
  bus::Subscriber late(connect_tcp("late"), {"grid/state"});
  const auto message = late.receive(patience);
  ASSERT_TRUE(message.has_value());
  EXPECT_EQ(floats_of(*message, "values"), (std::vector<float>{1, 2, 3}));
}

TEST_F(Tcp, WhoOnlyWantsToKnowTheTopicsIsSentNoTensor) {
  const auto context = connect("maker");
  NumberPublisher publisher(context, "viewer/probe");
  const auto slab = context->create_slab("frames", 2, 1000);
  bus::Subscriber local(connect("local"), {"viewer/probe"});
  meet(publisher, local);
  std::map<std::string, std::pair<std::uint64_t, std::uint64_t>> seen;  // messages, bytes
  bus::Subscriber remote(connect_tcp("remote"));
  remote.on(topics::kTopics, [&](const wire::Topics& topics, const bus::Message&) {
    for (const auto* topic : *topics.topics()) {
      seen[topic->name()->str()] = {topic->messages(), topic->bytes()};
      if (topic->name()->str() != "viewer/probe") continue;
      EXPECT_EQ(topic->schemas()->Get(0)->str(), "ViewerProbe/1");
      EXPECT_EQ(topic->sources()->Get(0)->str(), "maker");
    }
  });
  std::uint64_t bytes = 0;
  for (int i = 0; i < 3; ++i) {
    publish_number(publisher, 5, false, "", {write_floats(*slab, {1, 2, 3})});
    const auto message = local.receive(patience);
    ASSERT_TRUE(message.has_value());
    bytes += message->size() + 12;
  }
  ASSERT_TRUE(eventually([&] {
    remote.dispatch_all(1ms);
    return seen["viewer/probe"].first == 3;
  }));
  EXPECT_EQ(seen["viewer/probe"].second, bytes);
  EXPECT_TRUE(seen.contains("sys/heartbeat"));
  EXPECT_EQ(broker_->statistics().inlined, 0u);
}

TEST_F(Tcp, ABrokerStopsAtOnce) {
  std::chrono::steady_clock::duration quickest = patience;
  for (int i = 0; i < 10; ++i) {
    broker_.reset();
    broker_ = std::make_unique<bus_service::Broker>(options());
    broker_->start();
    std::this_thread::sleep_for(5ms);  // by then all its threads wait for something
    const auto before = std::chrono::steady_clock::now();
    broker_->stop();
    quickest = std::min(quickest, std::chrono::steady_clock::now() - before);
  }
  EXPECT_LT(quickest, 50ms);
}

// A reader that is busy while more arrives than its queue holds: libzmq ended the process.
TEST_F(Tcp, AReaderGoesOnAfterItReadNothingForLong) {
  NumberPublisher publisher(connect("maker"), "viewer/probe");
  bus::Subscriber remote(connect_tcp("remote"), {"viewer/probe"});
  meet(publisher, remote);
  for (int number = 1; number <= 2000; ++number) publish_number(publisher, number, false, "", {});
  std::this_thread::sleep_for(8s);  // longer than a connection may be silent
  // Of what waited some may be lost.
  EXPECT_TRUE(eventually([&] {
    publish_number(publisher, 3000, false, "", {});
    const auto message = remote.receive(100ms);
    return message && number_of(*message) == 3000;
  }));
}

TEST(ConnectionWatch, HasTcpLookForThePeerAtBothEnds) {
  zmq::context_t context;
  zmq::socket_t server(context, zmq::socket_type::pair), client(context, zmq::socket_type::pair);
  for (zmq::socket_t* socket : {&server, &client}) {
    socket->set(zmq::sockopt::linger, 0);
    bus::watch_connections(*socket);
  }
  server.bind("tcp://127.0.0.1:*");
  client.connect(server.get(zmq::sockopt::last_endpoint));
  for (const auto& [from, to] : {std::pair(&server, &client), {&client, &server}}) {
    from->send(zmq::str_buffer("x"));
    zmq::message_t message;
    ASSERT_TRUE(to->recv(message));
    const int descriptor = message.get(ZMQ_SRCFD);
    int keeps_alive = 0, gone_ms = 0;
    socklen_t size = sizeof(int);
    ASSERT_EQ(::getsockopt(descriptor, SOL_SOCKET, SO_KEEPALIVE, &keeps_alive, &size), 0);
    ASSERT_EQ(::getsockopt(descriptor, IPPROTO_TCP, TCP_USER_TIMEOUT, &gone_ms, &size), 0);
    EXPECT_EQ(keeps_alive, 1);
    EXPECT_EQ(gone_ms, 5000);
  }
}

}  // namespace
}  // namespace splatbus::bus_test

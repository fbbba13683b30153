#include "viewer/stream_client.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <map>
#include <set>

#include "../../bus/bus_fixture.h"
#include "bus/keys.h"
#include "stream/bytes.h"
#include "wire/convert.h"

namespace splatbus::viewer {
namespace {

using namespace std::chrono_literals;

/// A streamer that says what the test wants, when it wants.
class StreamClientTest : public testing::Test {
 protected:
  StreamClientTest() {
    router_.set(zmq::sockopt::linger, 0);
    router_.bind(endpoint_);
  }

  [[nodiscard]] ClientOptions options() const { return {.endpoint = endpoint_, .name = "viewer", .probes = true}; }

  bool poll_until(StreamClient& client, const std::function<bool()>& condition) {
    return bus_test::eventually([&] { return client.poll(1ms), take(), condition(); });
  }
  void take() {
    zmq::message_t frame;
    while (router_.recv(frame, zmq::recv_flags::dontwait)) {
      const std::string peer = frame.to_string();
      zmq::message_t packet;
      (void)router_.recv(packet);
      const wire::Body body = stream::ParsedPacket::parse({packet.data<std::uint8_t>(), packet.size()}, {}).body();
      ++said_[body];
      if (body == wire::Body::Hello && peers_.insert(peer).second) peer_ = peer;
    }
  }
  [[nodiscard]] int said(wire::Body body) { return said_[body]; }
  void send(const stream::EncodedPacket& packet) {
    (void)router_.send(zmq::buffer(peer_), zmq::send_flags::sndmore);
    const auto flags = packet.payload.empty() ? zmq::send_flags::none : zmq::send_flags::sndmore;
    (void)router_.send(zmq::buffer(packet.packet), flags);
    if (!packet.payload.empty()) (void)router_.send(zmq::buffer(packet.payload), zmq::send_flags::none);
    sent_bytes_ += packet.bytes();
  }
  void welcome() {
    send(writer_.write(5, 0, wire::Body::Welcome,
                       [&](auto& b) { return wire::CreateWelcome(b, wire::Appearance::Transfer, 0, 5, 5); }));
  }
  void picture(std::uint64_t id) {
    const wire::Camera camera = to_wire(look_at({1, 2, 3}, {0, 0, 0}, 16, 8, 1));
    send(writer_.write(
        5, 0, wire::Body::ProbePicture,
        [&](auto& b) { return wire::CreateProbePicture(b, id, &camera, 512, 0, to_wire(b, Light{})); },
        stream::zstd_compress(stream::Bytes(512), 1)));
  }
  bus_test::TemporaryDirectory directory_;
  std::string endpoint_ = "ipc://" + directory_.path() + "/streamer";
  zmq::context_t context_;
  zmq::socket_t router_{context_, zmq::socket_type::router};
  stream::PacketWriter writer_{"streamer", 1};
  std::set<std::string> peers_;
  std::string peer_;                ///< the newest of them
  std::map<wire::Body, int> said_;  ///< by the client
  std::size_t sent_bytes_ = 0;
};

TEST_F(StreamClientTest, FollowsOverItsSocketAndSaysGoodbye) {
  {
    StreamClient client(options());
    EXPECT_FALSE(client.connected());
    ASSERT_TRUE(poll_until(client, [&] { return said(wire::Body::Hello) >= 1; }));
    welcome();
    ASSERT_TRUE(poll_until(client, [&] { return client.connected(); }));
    client.send_pose(look_at({1, 2, 3}, {0, 0, 0}, 64, 48, 1));
    client.send_probe(42, look_at({1, 2, 3}, {0, 0, 0}, 64, 48, 1));
    client.send_quality(42, {30, 0.5, 0.1}, 7);
    EXPECT_TRUE(poll_until(client, [&] {
      return said(wire::Body::Pose) == 1 && said(wire::Body::Probe) == 1 && said(wire::Body::Quality) == 1;
    }));
    picture(42);
    std::optional<ProbeAnswer> answer;
    ASSERT_TRUE(poll_until(client, [&] { return (answer = client.take_probe_answer()).has_value(); }));
    EXPECT_EQ(answer->probe_id, 42U);
    EXPECT_EQ(answer->rgba.size(), 512U);
    EXPECT_EQ(client.received_bytes(), sent_bytes_);
  }
  EXPECT_TRUE(bus_test::eventually([&] { return take(), said(wire::Body::Bye) == 1; }));
}

TEST_F(StreamClientTest, WhatIsWrongIsCountedAndTheRestIsTaken) {
  StreamClient client(options());
  ASSERT_TRUE(poll_until(client, [&] { return said(wire::Body::Hello) >= 1; }));
  const stream::Bytes nonsense(20, 7);
  send({wire::Body::Welcome, 0, nonsense, {}});
  send({wire::Body::Welcome, 0, nonsense, nonsense});
  // A frame too many is no part of anything.
  (void)router_.send(zmq::buffer(peer_), zmq::send_flags::sndmore);
  for (int frame = 0; frame < 3; ++frame) {
    (void)router_.send(zmq::buffer(nonsense), frame < 2 ? zmq::send_flags::sndmore : zmq::send_flags::none);
  }
  welcome();
  EXPECT_TRUE(poll_until(client, [&] { return client.connected(); }));
  EXPECT_EQ(client.refused(), 3U);
}

TEST_F(StreamClientTest, WhatItReceivesIsLoggedAsItCame) {
  ClientOptions logged = options();
  logged.packet_log = directory_.path() + "/packets";
  {
    StreamClient client(logged);
    ASSERT_TRUE(poll_until(client, [&] { return said(wire::Body::Hello) >= 1; }));
    welcome();
    picture(9);
    ASSERT_TRUE(poll_until(client, [&] { return client.received_bytes() == sent_bytes_; }));
  }
  stream::PacketLogReader reader(logged.packet_log);
  const auto first = reader.next(), second = reader.next();
  ASSERT_TRUE(first && second);
  EXPECT_EQ(stream::ParsedPacket::parse(first->packet, first->payload).body(), wire::Body::Welcome);
  EXPECT_TRUE(first->payload.empty());
  const auto picture = stream::ParsedPacket::parse(second->packet, second->payload);
  EXPECT_EQ(picture.root().body_as_ProbePicture()->probe_id(), 9U);
  EXPECT_EQ(stream::zstd_decompress(picture.payload(), 512, "picture"), stream::Bytes(512));
  EXPECT_FALSE(reader.next());
  EXPECT_THROW(stream::PacketLogReader(directory_.path() + "/none"), std::runtime_error);
}

TEST_F(StreamClientTest, AnotherBudgetCountsOn) {
  StreamClient client(options());
  const auto meet = [&] {
    const std::size_t before = peers_.size();
    ASSERT_TRUE(poll_until(client, [&] { return peers_.size() > before; }));
    welcome();
    send({wire::Body::Welcome, 0, stream::Bytes(20, 7), {}});
    ASSERT_TRUE(poll_until(client, [&] { return client.connected() && client.received_bytes() == sent_bytes_; }));
  };
  meet();
  EXPECT_FALSE(client.set_budget(stream::kMaxGaussians, 500)) << "the model has the size that it had";
  ASSERT_TRUE(client.set_budget(1000, 500));
  EXPECT_EQ(client.received_bytes(), sent_bytes_);
  EXPECT_EQ(client.refused(), 1U);
  meet();
  EXPECT_EQ(client.refused(), 2U);
  EXPECT_TRUE(bus_test::eventually([&] { return take(), said(wire::Body::Bye) == 1; }));
}

TEST_F(StreamClientTest, WithoutAWayToAnotherBudgetItKeepsTheOneThatItHas) {
  const bus::KeyPair server = bus::make_key_pair(), own = bus::make_key_pair();
  const std::string file = directory_.path() + "/own.key";
  bus::write_key_file(file, own);
  router_.set(zmq::sockopt::curve_server, true);
  std::string secret;
  for (std::size_t k = 0; k < server.secret_key.size(); k += 2) {
    secret += static_cast<char>(std::stoi(server.secret_key.substr(k, 2), nullptr, 16));
  }
  ASSERT_EQ(::zmq_setsockopt(router_.handle(), ZMQ_CURVE_SECRETKEY, secret.data(), secret.size()), 0);
  router_.bind("tcp://127.0.0.1:*");
  ClientOptions with_key = options();
  with_key.endpoint = router_.get(zmq::sockopt::last_endpoint);
  with_key.key = file;
  with_key.server_key = server.public_key;
  StreamClient client(with_key);
  ASSERT_TRUE(poll_until(client, [&] { return said(wire::Body::Hello) >= 1; }));
  std::filesystem::remove(file);
  EXPECT_FALSE(client.set_budget(1000, 500));
  welcome();
  EXPECT_TRUE(poll_until(client, [&] { return client.connected(); })) << "the link is gone";
  bus::write_key_file(file, own);
  EXPECT_TRUE(client.set_budget(1000, 500)) << "it thinks that it has it";
}

TEST_F(StreamClientTest, WhatATestLosesIsNotReceived) {
  StreamClient client(options());
  client.lose_packets([](const stream::ParsedPacket& packet) { return packet.body() == wire::Body::Welcome; });
  ASSERT_TRUE(poll_until(client, [&] { return said(wire::Body::Hello) >= 1; }));
  welcome();
  picture(1);
  ASSERT_TRUE(poll_until(client, [&] { return client.take_probe_answer().has_value(); }));
  EXPECT_FALSE(client.connected());
}

}  // namespace
}  // namespace splatbus::viewer

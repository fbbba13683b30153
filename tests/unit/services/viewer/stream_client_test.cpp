#include "viewer/stream_client.h"

#include <gtest/gtest.h>

#include "../../bus/bus_fixture.h"
#include "stream/bytes.h"
#include "stream/stream_model.h"
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
    return bus_test::eventually([&] { return client.poll(1ms), take_hellos(), condition(); });
  }
  void take_hellos() {
    zmq::message_t frame;
    while (router_.recv(frame, zmq::recv_flags::dontwait)) {
      peer_ = frame.to_string();
      zmq::message_t packet;
      (void)router_.recv(packet);
      const auto parsed = stream::ParsedPacket::parse({packet.data<std::uint8_t>(), packet.size()}, {});
      if (parsed.body() == wire::Body::Hello) ++hellos_;
      if (parsed.body() != wire::Body::Held) continue;
      const wire::Held& held = *parsed.root().body_as_Held();
      ++helds_;
      acknowledged_ += held.bytes();
      newest_ = held.newest();
      for (const wire::SequenceRange* range : *held.missing()) {
        missing_.push_back(range->first());
        missing_.push_back(range->last());
      }
    }
  }
  void send(const stream::EncodedPacket& packet) {
    (void)router_.send(zmq::buffer(peer_), zmq::send_flags::sndmore);
    const auto flags = packet.payload.empty() ? zmq::send_flags::none : zmq::send_flags::sndmore;
    (void)router_.send(zmq::buffer(packet.packet), flags);
    if (!packet.payload.empty()) (void)router_.send(zmq::buffer(packet.payload), zmq::send_flags::none);
    sent_bytes_ += packet.bytes();
  }
  void welcome(bool asks) {
    send(writer_.write(5, 0, wire::Body::Welcome, [&](auto& b) {
      return wire::CreateWelcome(b, wire::Appearance::Transfer, 0, 5, 5, asks, asks ? 0 : 1);
    }));
  }
  void picture(std::uint64_t id) {
    const wire::Camera camera = to_wire(look_at({1, 2, 3}, {0, 0, 0}, 16, 8, 1));
    send(writer_.write(
        5, 0, wire::Body::ProbePicture,
        [&](auto& b) { return wire::CreateProbePicture(b, id, &camera, 512, 0, to_wire(b, Light{})); },
        stream::zstd_compress(stream::Bytes(512), 1)));
  }
  bool all_received(StreamClient& client) {
    return poll_until(client, [&] { return client.received_bytes() == sent_bytes_; });
  }

  bus_test::TemporaryDirectory directory_;
  std::string endpoint_ = "ipc://" + directory_.path() + "/streamer";
  zmq::context_t context_;
  zmq::socket_t router_{context_, zmq::socket_type::router};
  stream::PacketWriter writer_{"streamer", 1};
  std::string peer_;
  int hellos_ = 0;
  int helds_ = 0;
  std::uint64_t newest_ = 0, acknowledged_ = 0;  ///< of Helds
  std::vector<std::uint64_t> missing_;           ///< firsts and lasts
  std::size_t sent_bytes_ = 0;
};

TEST_F(StreamClientTest, SaysWhatHasNotComeOnceAndWhatItHasReceived) {
  constexpr std::int64_t kMillisecond = 1'000'000;
  std::int64_t now_ns = 1'000'000 * kMillisecond;
  ClientOptions stepped = options();
  stepped.now_ns = [&] { return now_ns; };
  stepped.silence_ns = 1'000'000 * kMillisecond;
  StreamClient client(stepped);
  ASSERT_TRUE(poll_until(client, [&] { return now_ns += kMillisecond, hellos_ >= 1; }));
  welcome(false);
  for (const std::uint64_t sequence : {1U, 2U, 6U, 7U}) {
    send(writer_.write(5, sequence, wire::Body::Keepalive,
                       [](auto& b) { return wire::CreateKeepalive(b, 1, 1, 1, 1); }));
  }
  ASSERT_TRUE(all_received(client));
  ASSERT_TRUE(poll_until(client, [&] { return now_ns += 300 * kMillisecond, acknowledged_ == sent_bytes_; }));
  EXPECT_EQ(newest_, 7U);
  EXPECT_EQ(missing_, (std::vector<std::uint64_t>{3, 5}));
  EXPECT_EQ(client.lost(), 3U);
  // Nothing comes: nothing is said.
  const int said = helds_;
  for (int k = 0; k < 20; ++k) {
    now_ns += 300 * kMillisecond;
    client.poll(0ms);
    take_hellos();
  }
  EXPECT_EQ(helds_, said);
}

// A long way off, a second Hello leaves before the first one's answer is there.
TEST_F(StreamClientTest, TwoAnswersAreOneWelcome) {
  StreamClient client(options());
  ASSERT_TRUE(poll_until(client, [&] { return hellos_ >= 2; }));
  for (int answers = 1; answers <= 3; ++answers) {
    welcome(false);
    ASSERT_TRUE(all_received(client));
    EXPECT_TRUE(client.connected()) << answers << " answers";
  }
}

TEST_F(StreamClientTest, AnAskedViewerSaysHelloAgain) {
  StreamClient client(options());
  ASSERT_TRUE(poll_until(client, [&] { return hellos_ >= 1; }));
  welcome(false);
  ASSERT_TRUE(all_received(client));
  const int before = hellos_;
  welcome(true);
  welcome(true);
  EXPECT_TRUE(poll_until(client, [&] { return hellos_ > before; }));
  EXPECT_FALSE(client.connected());
  welcome(false);
  ASSERT_TRUE(all_received(client));
  EXPECT_TRUE(client.connected());
}

TEST_F(StreamClientTest, PicturesThatNobodyTakesAreBoundedInBytes) {
  ClientOptions small = options();
  small.held_picture_bytes = 1100;
  StreamClient client(small);
  ASSERT_TRUE(poll_until(client, [&] { return hellos_ >= 1; }));
  for (std::uint64_t id = 1; id <= 5; ++id) picture(id);
  ASSERT_TRUE(all_received(client));
  EXPECT_EQ(client.take_probe_answer()->probe_id, 1U);
  picture(6);
  ASSERT_TRUE(all_received(client));
  EXPECT_EQ(client.take_probe_answer()->probe_id, 2U);
  EXPECT_EQ(client.take_probe_answer()->probe_id, 6U);
  EXPECT_FALSE(client.take_probe_answer());
  EXPECT_EQ(client.refused(), 0U);
}

TEST_F(StreamClientTest, MeasuresHowLongScenesTook) {
  constexpr std::int64_t kMillisecond = 1'000'000;
  std::int64_t now_ns = 1'000'000 * kMillisecond;
  ClientOptions stepped = options();
  stepped.now_ns = [&] { return now_ns; };
  StreamClient client(stepped);
  ASSERT_TRUE(poll_until(client, [&] { return now_ns += kMillisecond, hellos_ >= 1; }));
  welcome(false);
  stream::StreamModel model(writer_, 4);
  ASSERT_TRUE(model.observe(GaussiansBuffer(ParameterLayout{}).view()));
  SceneState scene{.light = {}, .objects = {}, .version = 1};
  EXPECT_FALSE(model.take_scene(scene, {.capture_ns = 1}));
  model.reset_to_target();
  send(model.layout_packet());
  send(*model.scene_packet());
  ASSERT_TRUE(all_received(client));
  EXPECT_EQ(client.scene_delays().count(), 0U) << "the first one is old";
  for (int k = 1; k <= 200; ++k) {
    ++scene.version;
    const std::int64_t delay_ns = (k % 2 ? k : 201 - k) * kMillisecond;
    send(*model.take_scene(scene, {.capture_ns = now_ns - delay_ns}));
    ASSERT_TRUE(all_received(client));
  }
  EXPECT_EQ(client.replica().scene_version(), 201U);
  EXPECT_EQ(client.scene_delays().count(), 200U);
  EXPECT_DOUBLE_EQ(client.scene_delays().quantile(0.5), 99);
  EXPECT_DOUBLE_EQ(client.scene_delays().quantile(0.99), 197);
  EXPECT_EQ(client.refused(), 0U);
}

TEST_F(StreamClientTest, PicturesThatWereNotWantedAreIgnored) {
  ClientOptions without = options();
  without.probes = false;
  StreamClient client(without);
  ASSERT_TRUE(poll_until(client, [&] { return hellos_ >= 1; }));
  picture(1);
  ASSERT_TRUE(all_received(client));
  EXPECT_FALSE(client.take_probe_answer());
}

}  // namespace
}  // namespace splatbus::viewer

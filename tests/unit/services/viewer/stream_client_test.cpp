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
      if (parsed.body() == wire::Body::NeedSnapshot) {
        reasons_.push_back(parsed.root().body_as_NeedSnapshot()->reason()->str());
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
    send(writer_.write(5, 0, wire::Body::Welcome,
                       [&](auto& b) { return wire::CreateWelcome(b, wire::Appearance::Transfer, 0, 5, 5, asks); }));
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
  std::vector<std::string> reasons_;  ///< of NeedSnapshots
  std::size_t sent_bytes_ = 0;
};

TEST_F(StreamClientTest, AModelThatIsTooLargeIsRefusedWithItsReasonAndAskedForEverMoreSeldom) {
  constexpr std::int64_t kSecond = 1'000'000'000;
  std::int64_t now_ns = 1000 * kSecond;
  ClientOptions stepped = options();
  stepped.now_ns = [&] { return now_ns; };
  stepped.silence_ns = 1000 * kSecond;
  StreamClient client(stepped);
  ASSERT_TRUE(poll_until(client, [&] { return now_ns += kSecond, hellos_ >= 1; }));
  welcome(false);
  const auto begin = [&](std::uint64_t total) {
    const stream::StreamLayout layout;
    send(writer_.write(5, 0, wire::Body::SnapshotBegin, [&](auto& b) {
      std::vector<flatbuffers::Offset<wire::TensorMetadata>> attributes;
      for (const stream::AttributeChannels& a : layout.attributes()) {
        const wire::Quantizer quantizer(a.quantizer.offset, a.quantizer.step);
        attributes.push_back(
            wire::CreateTensorMetadata(b, a.attribute, static_cast<std::uint32_t>(a.channels), &quantizer));
      }
      return wire::CreateSnapshotBegin(b, 1, 1, static_cast<std::uint32_t>(total), total > 0 ? 1 : 0,
                                       wire::Appearance::Transfer, 0, b.CreateVector(attributes));
    }));
  };
  begin(stream::kMaxGaussians + 1);
  ASSERT_TRUE(all_received(client));
  for (int step = 0; step < 60 * 4; ++step) {
    now_ns += kSecond / 4;
    const std::uint64_t asked = client.snapshot_requests();
    client.poll(0ms);
    if (client.snapshot_requests() == asked) continue;
    begin(stream::kMaxGaussians + 1);  // a streamer that knows no bound
    ASSERT_TRUE(all_received(client));
  }
  EXPECT_GE(client.snapshot_requests(), 3U);
  EXPECT_LE(client.snapshot_requests(), 6U) << "in a minute";
  ASSERT_TRUE(poll_until(client, [&] { return reasons_.size() == client.snapshot_requests(); }));
  EXPECT_NE(reasons_.front().find("4194305 Gaussians"), std::string::npos) << reasons_.front();
  // A smaller one is taken, and ends it.
  begin(0);
  ASSERT_TRUE(all_received(client));
  EXPECT_FALSE(client.replica().needs_snapshot());
  const std::uint64_t asked = client.snapshot_requests();
  now_ns += 500 * kSecond;
  client.poll(0ms);
  EXPECT_EQ(client.snapshot_requests(), asked);
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
  stream::StreamModel model(writer_, 5);
  ASSERT_TRUE(model.observe(GaussiansBuffer(ParameterLayout{}).view()));
  SceneState scene{.light = {}, .objects = {}, .version = 1};
  EXPECT_TRUE(model.take_scene(scene, {.capture_ns = 1}).empty());
  model.reset_to_target();
  for (const auto& packet : model.snapshot().head) send(packet);
  ASSERT_TRUE(all_received(client));
  EXPECT_EQ(client.scene_delays().count(), 0U) << "a snapshot's scene is old";
  for (int k = 1; k <= 200; ++k) {
    ++scene.version;
    const std::int64_t delay_ns = (k % 2 ? k : 201 - k) * kMillisecond;
    for (const auto& packet : model.take_scene(scene, {.capture_ns = now_ns - delay_ns})) send(packet);
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

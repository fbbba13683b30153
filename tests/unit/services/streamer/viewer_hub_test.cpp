#include "streamer/viewer_hub.h"

#include <gtest/gtest.h>

#include "../../bus/bus_fixture.h"
#include "../../stream/toy_server.h"
#include "wire/convert.h"

namespace splatbus::streamer {
namespace {

constexpr std::int64_t kSecond = 1'000'000'000;

/// A hub under the test's clock, and one viewer that reads when it is told to.
class ViewerHubTest : public testing::Test {
 protected:
  ViewerHubTest() : endpoint_({"ipc://" + directory_.path() + "/streamer"}) {
    socket_.set(zmq::sockopt::linger, 0);
    socket_.set(zmq::sockopt::rcvhwm, 1);
    socket_.connect(endpoint_.bound().front());
  }

  void say(wire::Body body, auto build) {
    (void)socket_.send(zmq::buffer(writer_.write(0, 0, body, build).packet), zmq::send_flags::dontwait);
  }
  void join() {
    say(wire::Body::Hello, [](auto& b) { return wire::CreateHelloDirect(b, "slow", nullptr, true); });
    ASSERT_TRUE(bus_test::eventually([&] { return hub_.receive(now_ns_), hub_.viewers() == 1; }));
  }
  /// The next packet, if it is there already.
  std::optional<stream::ParsedPacket> read() {
    zmq::message_t packet, payload;
    if (!socket_.recv(packet, zmq::recv_flags::dontwait)) return std::nullopt;
    if (packet.more()) (void)socket_.recv(payload);
    return stream::ParsedPacket::parse({packet.data<std::uint8_t>(), packet.size()},
                                       {payload.data<std::uint8_t>(), payload.size()});
  }
  std::uint64_t sent_packets() {
    std::uint64_t packets = 0;
    for (const auto& type : hub_.statistics().close_window(now_ns_).types) packets += type.packets;
    return packets;
  }

  bus_test::TemporaryDirectory directory_;
  zmq::context_t context_;
  zmq::socket_t socket_{context_, zmq::socket_type::dealer};
  stream::PacketWriter writer_{"viewer", 1};
  Endpoint endpoint_;
  stream::StreamModel model_{stream::PacketWriter("streamer", 1), 77, stream::StreamOptions{.chunk_gaussians = 8}};
  std::uint64_t qualities_ = 0;
  ViewerHub hub_{endpoint_, model_, stream::PacketWriter("streamer", 1), HubOptions{},
                 HubEvents{.pose = [](const auto&, const auto&) {},
                           .probe = [](const auto&, const auto&) {},
                           .quality = [this](const auto&, const auto&) { ++qualities_; }}};
  std::int64_t now_ns_ = kSecond;
};

TEST_F(ViewerHubTest, AViewerThatReadsSlowlyIsNotForgotten) {
  const GaussiansBuffer model = stream::test::toy_model(20'000, 1);
  ASSERT_TRUE(model_.observe(model.view()));
  model_.reset_to_target();
  join();
  ASSERT_TRUE(hub_.pump(now_ns_)) << "the whole snapshot went out at once";
  for (int second = 0; second < 12; ++second) {
    now_ns_ += kSecond;
    const std::uint64_t sent = sent_packets(), heard = qualities_;
    say(wire::Body::Quality, [](auto& b) { return wire::CreateQuality(b, 1); });
    bool full = true;
    ASSERT_TRUE(bus_test::eventually([&] {
      (void)read();
      hub_.receive(now_ns_);
      full = hub_.pump(now_ns_);
      return sent_packets() > sent && qualities_ > heard;
    }));
    ASSERT_TRUE(full) << "the snapshot is too small for this test";
    hub_.expire(now_ns_);
    ASSERT_EQ(hub_.viewers(), 1U) << "after " << second + 1 << " s";
  }
  EXPECT_EQ(hub_.snapshots(), 1U);
  EXPECT_EQ(hub_.lost_viewers(), 0U);
  // And one that stops reading is.
  now_ns_ += 6 * kSecond;
  hub_.expire(now_ns_);
  EXPECT_EQ(hub_.viewers(), 0U);
}

TEST_F(ViewerHubTest, AViewerThatTalksAndDoesNotReadIsRemoved) {
  ASSERT_TRUE(model_.observe(stream::test::toy_model(20'000, 1).view()));
  model_.reset_to_target();
  join();
  ASSERT_TRUE(hub_.pump(now_ns_)) << "the whole snapshot went out at once";
  // Until the sockets' own buffers are full, something still goes out in each second.
  for (int second = 0; second < 30 && hub_.viewers() == 1; ++second) {
    now_ns_ += kSecond;
    const std::uint64_t heard = qualities_;
    say(wire::Body::Quality, [](auto& b) { return wire::CreateQuality(b, 1); });
    ASSERT_TRUE(bus_test::eventually([&] { return hub_.receive(now_ns_), qualities_ > heard; }));
    hub_.pump(now_ns_);
    hub_.expire(now_ns_);
  }
  EXPECT_EQ(hub_.viewers(), 0U);
  EXPECT_EQ(hub_.lost_viewers(), 1U);
  // Nothing is queued for it any more, however much it reads.
  while (read()) {
  }
  const std::uint64_t sent = sent_packets();
  EXPECT_FALSE(hub_.pump(now_ns_));
  hub_.send_keepalive();
  EXPECT_EQ(sent_packets(), sent);
}

TEST_F(ViewerHubTest, HoweverOftenAViewerAsksSnapshotsBeginSecondsApart) {
  ASSERT_TRUE(model_.observe(stream::test::toy_model(50, 1).view()));
  model_.reset_to_target();
  join();
  constexpr int kAsked = 400, kSeconds = 8;
  for (int k = 1; k <= kAsked; ++k) {
    hub_.pump(now_ns_);
    now_ns_ += kSeconds * kSecond / kAsked;
    const std::uint64_t heard = qualities_;
    say(wire::Body::NeedSnapshot, [](auto& b) { return wire::CreateNeedSnapshotDirect(b, "greed"); });
    say(wire::Body::Quality, [](auto& b) { return wire::CreateQuality(b, 1); });
    ASSERT_TRUE(bus_test::eventually([&] {
      while (read()) {
      }
      return hub_.receive(now_ns_), qualities_ > heard;
    }));
  }
  EXPECT_GE(hub_.snapshots(), 3U);
  EXPECT_LE(hub_.snapshots(), 5U) << kAsked << " were asked for in " << kSeconds << " s";
  // The last one that was asked for is not forgotten.
  const std::uint64_t before = hub_.snapshots();
  now_ns_ += 3 * kSecond;
  hub_.pump(now_ns_);
  EXPECT_EQ(hub_.snapshots(), before + 1);
}

TEST_F(ViewerHubTest, AProbePictureWaitsForAFullViewer) {
  const GaussiansBuffer model = stream::test::toy_model(20'000, 1);
  ASSERT_TRUE(model_.observe(model.view()));
  model_.reset_to_target();
  join();
  ASSERT_TRUE(hub_.pump(now_ns_));
  for (std::uint64_t id = 1; id <= 20; ++id) {
    stream::EncodedPacket picture = writer_.write(77, 0, wire::Body::ProbePicture, [&](auto& b) {
      const wire::Camera camera;
      return wire::CreateProbePicture(b, id, &camera, 0, 0, to_wire(b, Light{}));
    });
    hub_.send_probe_picture(id, picture);
  }
  std::vector<std::uint64_t> arrived;
  ASSERT_TRUE(bus_test::eventually([&] {
    hub_.pump(now_ns_);
    while (const auto packet = read()) {
      if (packet->body() == wire::Body::ProbePicture) {
        arrived.push_back(packet->root().body_as_ProbePicture()->probe_id());
      }
    }
    return !arrived.empty() && arrived.back() == 20;
  }));
  EXPECT_EQ(arrived, (std::vector<std::uint64_t>{13, 14, 15, 16, 17, 18, 19, 20})) << "the newest are kept";
}

TEST_F(ViewerHubTest, AWelcomeAsksOnlyWhomItDoesNotKnow) {
  const auto next_welcome = [&] {
    std::optional<stream::ParsedPacket> packet;
    EXPECT_TRUE(bus_test::eventually([&] { return hub_.receive(now_ns_), packet = read(), packet.has_value(); }));
    return packet->root().body_as_Welcome()->asks();
  };
  say(wire::Body::Quality, [](auto& b) { return wire::CreateQuality(b, 1); });
  EXPECT_TRUE(next_welcome());
  for (int i = 0; i < 2; ++i) {
    say(wire::Body::Hello, [](auto& b) { return wire::CreateHelloDirect(b, "viewer"); });
    EXPECT_FALSE(next_welcome());
  }
}

}  // namespace
}  // namespace splatbus::streamer

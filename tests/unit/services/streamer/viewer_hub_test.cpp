#include "streamer/viewer_hub.h"

#include <gtest/gtest.h>

#include <deque>

#include "../../bus/bus_fixture.h"
#include "../../nanoseconds.h"
#include "../../stream/toy_server.h"
#include "wire/convert.h"

namespace splatbus::streamer {
namespace {

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
    auto parsed = stream::ParsedPacket::parse({packet.data<std::uint8_t>(), packet.size()},
                                              {payload.data<std::uint8_t>(), payload.size()});
    newest_ = std::max(newest_, parsed.sequence());
    return parsed;
  }
  /// What has come so far.
  void acknowledge() {
    if (newest_ == said_) return;
    said_ = newest_;
    const auto held = writer_.write(model_.status().epoch, 0, wire::Body::Held,
                                    [&](auto& b) { return wire::CreateHeldDirect(b, newest_); });
    (void)socket_.send(zmq::buffer(held.packet), zmq::send_flags::dontwait);
  }
  void pose() {
    const wire::Camera camera = to_wire(look_at({1, 2, 3}, {0, 0, 0}, 64, 48, 1));
    say(wire::Body::Pose, [&](auto& b) { return wire::CreatePose(b, &camera); });
  }
  void probe(std::uint64_t id) {
    const wire::Camera camera = to_wire(look_at({1, 2, 3}, {0, 0, 0}, 64, 48, 1));
    say(wire::Body::Probe, [&](auto& b) { return wire::CreateProbe(b, id, &camera); });
  }
  void publish(const GaussiansBuffer& model) {
    ASSERT_TRUE(model_.observe(model.view()));
    model_.reset_to_target();
    hub_.restart_all();
  }
  /// Pumps, and gives the replica what has come, until the condition holds.
  bool follow(stream::Replica& replica, const std::function<bool()>& condition) {
    return bus_test::eventually([&] {
      hub_.pump(now_ns_ += kSecond / 100);
      while (const auto packet = read()) {
        scenes_ += packet->body() == wire::Body::Scene ? 1 : 0;
        replica.receive(*packet);
      }
      acknowledge();
      hub_.receive(now_ns_);
      return condition();
    });
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
  stream::StreamModel model_{stream::PacketWriter("streamer", 1), 77, stream::StreamOptions{}};
  std::uint64_t poses_ = 0, scenes_ = 0, qualities_ = 0, newest_ = 0, said_ = 0;
  std::vector<std::uint64_t> probes_;
  ViewerHub hub_{endpoint_, model_, stream::PacketWriter("streamer", 1), HubOptions{.viewer_kbps = 1e7},
                 HubEvents{.pose = [this](const auto&, const auto&) { ++poses_; },
                           .probe = [this](const auto&, const auto& body) { probes_.push_back(body.probe_id()); },
                           .quality = [this](const auto&, const auto&) { ++qualities_; }}};
  std::int64_t now_ns_ = kSecond;
};

TEST_F(ViewerHubTest, AViewerThatReadsSlowlyIsNotForgotten) {
  join();
  publish(stream::test::toy_model(400'000, 1));
  ASSERT_TRUE(hub_.pump(now_ns_)) << "all of it went out at once";
  for (int second = 0; second < 12; ++second) {
    now_ns_ += kSecond;
    const std::uint64_t sent = sent_packets(), heard = poses_;
    pose();
    bool waits = true;
    ASSERT_TRUE(bus_test::eventually([&] {
      if (sent_packets() == sent) (void)read();
      acknowledge();
      hub_.receive(now_ns_ += kSecond / 100);
      waits = hub_.pump(now_ns_);
      return sent_packets() > sent && poses_ > heard;
    }));
    if (!waits) {  // all of it has gone out
      ASSERT_GT(second, 6) << "the model is too small for this test";
      break;
    }
    hub_.expire(now_ns_);
    ASSERT_EQ(hub_.viewers(), 1U) << "after " << second + 1 << " s";
  }
  EXPECT_EQ(hub_.lost_viewers(), 0U);
  // And one that stops reading is.
  now_ns_ += 6 * kSecond;
  hub_.expire(now_ns_);
  EXPECT_EQ(hub_.viewers(), 0U);
}

TEST_F(ViewerHubTest, AViewerThatTalksAndDoesNotReadIsRemoved) {
  join();
  publish(stream::test::toy_model(200'000, 1));
  ASSERT_TRUE(hub_.pump(now_ns_)) << "all of it went out at once";
  ASSERT_TRUE(bus_test::eventually([&] { return read() && newest_ > 0; }));
  acknowledge();
  // A little still goes out in each second.
  for (int second = 0; second < 30 && hub_.viewers() == 1; ++second) {
    now_ns_ += kSecond;
    const std::uint64_t heard = poses_;
    pose();
    ASSERT_TRUE(bus_test::eventually([&] { return hub_.receive(now_ns_), poses_ > heard; }));
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
  hub_.send_keepalive(now_ns_);
  EXPECT_EQ(sent_packets(), sent);
}

// All that it is sent: what it joins with, scenes at the engine's rate, keepalives.
TEST_F(ViewerHubTest, NoSecondHasMoreThanATenthAboveTheRateWhateverIsSent) {
  constexpr double kKbps = 1500;
  hub_.set_rates(kKbps, 0);
  publish(stream::test::toy_model(60'000, 1));
  join();
  SceneState scene;
  std::deque<double> window;
  double bytes = 0, largest = 0;
  std::uint64_t come = 0;
  for (int step = 0; step < 500; ++step) {
    now_ns_ += kSecond / 100;
    if (step % 3 == 0) {
      ++scene.version;
      scene.objects[7].rigid.translation.x += 0.5F;
      if (const auto packet = model_.take_scene(scene, {})) hub_.add_scene(*packet);
    }
    if (step % 100 == 99) hub_.send_keepalive(now_ns_);
    hub_.pump(now_ns_);
    // All that was sent has come, and that is known.
    const auto now_sent = hub_.statistics().close_window(now_ns_);
    std::uint64_t sent = 0;
    for (const auto& type : now_sent.types) sent += type.packets;
    EXPECT_TRUE(bus_test::eventually([&] {
      while (read()) ++come;
      return come >= sent;
    }));
    if (step % 5 == 0) acknowledge();
    hub_.receive(now_ns_);
    bytes += static_cast<double>(now_sent.bytes);
    window.push_back(bytes);
    if (window.size() <= 100) continue;
    largest = std::max(largest, window.back() - window.front());
    window.pop_front();
  }
  EXPECT_LE(largest, kKbps * 125 * 1.1);
  EXPECT_GT(largest, kKbps * 125 * 0.7) << "the rate was not used";
}

TEST_F(ViewerHubTest, WhatAViewerWantsAtMostIsHeardOfAtOnceAndLater) {
  publish(stream::test::toy_model(60'000, 1));
  say(wire::Body::Hello,
      [](auto& b) { return wire::CreateHelloDirect(b, "modest", nullptr, false, 0, nullptr, 0, 0, 800); });
  ASSERT_TRUE(bus_test::eventually([&] { return hub_.receive(now_ns_), hub_.viewers() == 1; }));
  const auto said_kbps = [&]() -> std::uint32_t {
    hub_.pump(now_ns_ += kSecond);
    hub_.send_keepalive(now_ns_);
    std::uint32_t kbps = 0;
    EXPECT_TRUE(bus_test::eventually([&] {
      while (const auto packet = read()) {
        if (packet->body() == wire::Body::Keepalive) kbps = packet->root().body_as_Keepalive()->kbps();
      }
      return kbps != 0;
    }));
    return kbps;
  };
  EXPECT_EQ(said_kbps(), 800U);
  (void)socket_.send(zmq::buffer(writer_
                                     .write(model_.status().epoch, 0, wire::Body::Held,
                                            [](auto& b) {
                                              return wire::CreateHeldDirect(b, 0, nullptr, 0, 0, nullptr, nullptr,
                                                                            false, 0, 300);
                                            })
                                     .packet),
                     zmq::send_flags::dontwait);
  EXPECT_TRUE(bus_test::eventually([&] { return hub_.receive(now_ns_), said_kbps() == 300; }));
}

TEST_F(ViewerHubTest, ViewersDropThePagesThatEnd) {
  join();
  publish(stream::test::toy_model(3000, 1));
  stream::Replica replica;
  ASSERT_TRUE(follow(replica, [&] { return replica.count() == 3000; }));
  ASSERT_TRUE(model_.observe(stream::test::toy_model(1024, 1).view()));
  model_.set_holders(hub_.followed_pages());
  model_.make_tick(1e9, {});
  hub_.add(model_.take_update());
  EXPECT_TRUE(follow(replica, [&] { return replica.held_pages().size() == 1; })) << replica.held_pages().size();
  EXPECT_EQ(hub_.followed_pages(), std::set<std::uint32_t>{0});
}

TEST_F(ViewerHubTest, WhatWasSentToThoseWhoLeftStillCounts) {
  join();
  publish(stream::test::toy_model(3000, 1));
  stream::Replica replica;
  ASSERT_TRUE(follow(replica, [&] { return replica.count() == 3000; }));
  ASSERT_EQ(hub_.counts().whole_pages, 3U);
  hub_.expire(now_ns_ += 60 * kSecond);
  ASSERT_EQ(hub_.viewers(), 0U);
  EXPECT_EQ(hub_.counts().whole_pages, 3U);
}

TEST_F(ViewerHubTest, OfScenesThatWaitTooLongAWholeOneIsSent) {
  join();
  publish(stream::test::toy_model(100, 1));
  SceneState scene;
  for (scene.version = 1; scene.version <= 100; ++scene.version) {
    scene.objects[7].rigid.translation.x += 0.5F;
    const auto packet = model_.take_scene(scene, {});
    ASSERT_TRUE(packet);
    hub_.add_scene(*packet);
  }
  stream::Replica replica;
  EXPECT_TRUE(follow(replica, [&] { return replica.scene_version() == 100; })) << replica.scene_version();
  EXPECT_LE(scenes_, 8U);
}

TEST_F(ViewerHubTest, OfAFloodOfPosesTheNewestIsPassedOnAtTheHubsOwnPace) {
  join();
  // A second's worth in a moment, for three seconds.
  for (int second = 0; second < 3; ++second) {
    const std::uint64_t before = poses_;
    for (int k = 0; k < 100; ++k) {
      pose();
      if (k % 20 == 0) hub_.receive(now_ns_ += kSecond / 100);
    }
    now_ns_ += kSecond;
    ASSERT_TRUE(bus_test::eventually([&] { return hub_.receive(now_ns_), poses_ > before; }));
  }
  EXPECT_LE(poses_, 3U * 66);
  EXPECT_GE(poses_, 3U);
}

TEST_F(ViewerHubTest, ProbesInFlightAreFewAndNobodyTakesAnothersOver) {
  join();
  for (std::uint64_t id = 1; id <= 30; ++id) probe(id);
  ASSERT_TRUE(bus_test::eventually([&] { return hub_.receive(now_ns_), hub_.ignored() + probes_.size() >= 30; }));
  EXPECT_EQ(probes_.size(), ViewerHub::kProbesOfOne);
  // Another viewer asks under the first one's number: the picture stays the first one's.
  zmq::socket_t other(context_, zmq::socket_type::dealer);
  other.set(zmq::sockopt::linger, 0);
  other.connect(endpoint_.bound().front());
  const auto tell = [&](wire::Body body, auto build) {
    (void)other.send(zmq::buffer(writer_.write(0, 0, body, build).packet), zmq::send_flags::none);
  };
  tell(wire::Body::Hello, [](auto& b) { return wire::CreateHelloDirect(b, "other", nullptr, true); });
  ASSERT_TRUE(bus_test::eventually([&] { return hub_.receive(now_ns_), hub_.viewers() == 2; }));
  const wire::Camera camera = to_wire(look_at({1, 2, 3}, {0, 0, 0}, 64, 48, 1));
  const std::uint64_t ignored = hub_.ignored();
  tell(wire::Body::Probe, [&](auto& b) { return wire::CreateProbe(b, 1, &camera); });
  ASSERT_TRUE(bus_test::eventually([&] { return hub_.receive(now_ns_), hub_.ignored() > ignored; }));
  hub_.send_probe_picture(1, writer_.write(77, 0, wire::Body::ProbePicture, [&](auto& b) {
    return wire::CreateProbePicture(b, 1, &camera, 0, 0, to_wire(b, Light{}));
  }));
  bool arrived = false;
  ASSERT_TRUE(bus_test::eventually([&] {
    hub_.pump(now_ns_);
    while (const auto packet = read()) arrived = arrived || packet->body() == wire::Body::ProbePicture;
    return arrived;
  }));
  zmq::message_t frame;
  while (other.recv(frame, zmq::recv_flags::dontwait)) {
    EXPECT_NE(stream::ParsedPacket::parse({frame.data<std::uint8_t>(), frame.size()}, {}).body(),
              wire::Body::ProbePicture);
    while (frame.more()) (void)other.recv(frame);
  }
}

TEST_F(ViewerHubTest, WhatNobodyKnownSaysIsAnsweredSoOften) {
  for (int k = 0; k < 500; ++k) {
    say(wire::Body::Quality, [](auto& b) { return wire::CreateQuality(b, 1); });
    hub_.receive(now_ns_);
  }
  ASSERT_TRUE(bus_test::eventually([&] { return hub_.receive(now_ns_), hub_.ignored() > 100; }));
  EXPECT_LE(sent_packets(), 50U);
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

TEST_F(ViewerHubTest, AQualityCountsForAPictureThatWasSentAndOnce) {
  join();
  const auto quality = [&](std::uint64_t id) {
    const std::uint64_t known = qualities_ + hub_.ignored();
    say(wire::Body::Quality, [&](auto& b) { return wire::CreateQuality(b, id, 99, 1, 0); });
    return bus_test::eventually([&] { return hub_.receive(now_ns_), qualities_ + hub_.ignored() > known; });
  };
  ASSERT_TRUE(quality(7));
  EXPECT_EQ(qualities_, 0U) << "of a picture that it was never sent";
  probe(7);
  ASSERT_TRUE(bus_test::eventually([&] { return hub_.receive(now_ns_), probes_.size() == 1; }));
  const wire::Camera camera = to_wire(look_at({1, 2, 3}, {0, 0, 0}, 64, 48, 1));
  hub_.send_probe_picture(7, writer_.write(77, 0, wire::Body::ProbePicture, [&](auto& b) {
    return wire::CreateProbePicture(b, 7, &camera, 0, 0, to_wire(b, Light{}));
  }));
  ASSERT_TRUE(quality(7));
  EXPECT_EQ(qualities_, 1U);
  ASSERT_TRUE(quality(7));
  EXPECT_EQ(qualities_, 1U) << "said again";
}

TEST_F(ViewerHubTest, HellosAloneFillItForSecondsOnly) {
  const std::size_t most = HubOptions().max_viewers;
  std::vector<zmq::socket_t> crowd;
  for (std::size_t i = 0; i < most; ++i) {
    crowd.emplace_back(context_, zmq::socket_type::dealer);
    crowd.back().set(zmq::sockopt::linger, 0);
    crowd.back().connect(endpoint_.bound().front());
  }
  const auto hello = writer_.write(0, 0, wire::Body::Hello, [](auto& b) { return wire::CreateHelloDirect(b, "x"); });
  // Strangers are answered so many times a second.
  ASSERT_TRUE(bus_test::eventually([&] {
    for (zmq::socket_t& socket : crowd) (void)socket.send(zmq::buffer(hello.packet), zmq::send_flags::dontwait);
    hub_.receive(now_ns_ += kSecond / 10);
    return hub_.viewers() == most;
  }));
  now_ns_ += 6 * kSecond;
  hub_.expire(now_ns_);
  EXPECT_EQ(hub_.viewers(), 0U);
  // Of the crowd's hellos some may still be on their way.
  EXPECT_TRUE(bus_test::eventually([&] {
    say(wire::Body::Hello, [](auto& b) { return wire::CreateHelloDirect(b, "slow", nullptr, true); });
    hub_.receive(now_ns_ += kSecond / 10);
    hub_.expire(now_ns_);
    return read().has_value();
  }));
}

}  // namespace
}  // namespace splatbus::streamer

// Losses, restarts, garbage and viewers that do not read.
#include "bus/clock.h"
#include "bus/error.h"
#include "streamer_fixture.h"

namespace splatbus::stream_test {
namespace {

TEST_F(StreamerTest, WhatWasLostIsSentAgainAndNothingElse) {
  start_streamer();
  std::mt19937 random(5);
  GaussiansBuffer model = stream::test::toy_model(400, 1);
  trainer_.publish(model);
  StreamClient good(client_options("good")), lossy(client_options("lossy"));
  ASSERT_TRUE(poll_until([&] { return good.replica().view().count == 400 && lossy.replica().view().count == 400; },
                         good, lossy));
  std::mt19937 dice(7);
  int lost = 0;
  lossy.lose_packets([&](const stream::ParsedPacket& packet) {
    const bool lose = packet.sequence() != 0 && dice() % 2 == 0 && lost < 20;
    lost += lose ? 1 : 0;
    return lose;
  });
  for (int round = 0; round < 12; ++round) {
    disturb(model, random);
    trainer_.publish(model);
    const std::uint64_t before = good.replica().held()->sequence;
    ASSERT_TRUE(poll_until([&] { return good.replica().held()->sequence > before; }, good, lossy));
  }
  EXPECT_TRUE(
      poll_until([&] { return lossy.replica().held()->sequence == good.replica().held()->sequence; }, good, lossy));
  EXPECT_TRUE(lossy.replica().held()->gaussians == good.replica().held()->gaussians);
  EXPECT_GT(lost, 5);
  EXPECT_GT(lossy.resends(), 0U);
  EXPECT_EQ(lossy.snapshot_requests(), 0U);
}

TEST_F(StreamerTest, ThePictureStaysWhenTheStreamerIsRestarted) {
  start_streamer();
  trainer_.publish(stream::test::toy_model(300, 1));
  StreamClient client(client_options("one"));
  ASSERT_TRUE(poll_until([&] { return client.replica().view().count == 300; }, client));
  const std::uint64_t epoch = client.replica().epoch();
  streamer_.reset();
  bool vanished = false;
  const auto watch = [&] { vanished = vanished || client.replica().view().count == 0; };
  start_streamer();
  GaussiansBuffer model = stream::test::toy_model(300, 1);
  grow(model, 50, 9);
  trainer_.publish(model);
  EXPECT_TRUE(poll_until(
      [&] { return watch(), client.replica().epoch() != epoch && client.replica().view().count == 350; }, client));
  EXPECT_FALSE(vanished);
}

TEST_F(StreamerTest, GarbageFromAViewerDisturbsNobody) {
  start_streamer();
  trainer_.publish(stream::test::toy_model(100, 1));
  zmq::context_t context;
  zmq::socket_t hostile(context, zmq::socket_type::dealer);
  hostile.set(zmq::sockopt::linger, 0);
  hostile.connect(endpoint());
  std::mt19937 random(11);
  const stream::PacketWriter writer("hostile", 1);
  for (int round = 0; round < 400; ++round) {
    stream::Bytes bytes;
    if (round % 2 == 0) {
      bytes.resize(random() % 200);
      for (auto& byte : bytes) byte = static_cast<std::uint8_t>(random());
    } else {
      const Camera camera;  // zero pixels, zero focal length
      const wire::Camera wired = to_wire(camera);
      bytes = writer
                  .write(1, 0, wire::Body::Hello,
                         [&](auto& b) { return wire::CreateHelloDirect(b, "x\n\x1b[31m", &wired, true, ~0ULL); })
                  .packet;
      for (int k = 0; k < 3 && round % 4 == 1; ++k)
        bytes[random() % bytes.size()] = static_cast<std::uint8_t>(random());
    }
    const auto flags = round % 5 == 0 ? zmq::send_flags::sndmore : zmq::send_flags::none;
    (void)hostile.send(zmq::buffer(bytes), flags);
    if (round % 5 == 0) (void)hostile.send(zmq::buffer(bytes), zmq::send_flags::none);
  }
  const auto resend = writer.write(1, 0, wire::Body::Resend, [](auto& b) { return wire::CreateResend(b, 0, ~0ULL); });
  (void)hostile.send(zmq::buffer(resend.packet), zmq::send_flags::none);
  StreamClient client(client_options("good"));
  EXPECT_TRUE(poll_until([&] { return client.replica().view().count == 100; }, client));
  EXPECT_EQ(client.refused(), 0U);
}

TEST_F(StreamerTest, AViewerThatDoesNotReadIsForgottenAndTheOthersGoOn) {
  start_streamer({{"viewer_timeout_s", "0.5"}, {"history_mb", "1"}});
  std::mt19937 random(13);
  GaussiansBuffer model = stream::test::toy_model(3000, 1);
  trainer_.publish(model);
  StreamClient good(client_options("good"));
  zmq::context_t context;
  zmq::socket_t deaf(context, zmq::socket_type::dealer);
  deaf.set(zmq::sockopt::linger, 0);
  deaf.set(zmq::sockopt::rcvhwm, 1);
  deaf.set(zmq::sockopt::rcvbuf, 4096);
  deaf.connect(endpoint());
  const stream::PacketWriter writer("deaf", 1);
  const auto say = [&](wire::Body body, auto build) {
    (void)deaf.send(zmq::buffer(writer.write(0, 0, body, build).packet), zmq::send_flags::dontwait);
  };
  say(wire::Body::Hello, [](auto& b) { return wire::CreateHelloDirect(b, "deaf"); });
  bus::Subscriber stats(observer_, {"stream/stats"});
  std::int64_t published_ns = 0;
  const bool forgotten = wait_message<wire::StreamStats>(
      stats, "StreamStats/1", [](const auto& body) { return body.lost_viewers() > 0; },
      [&] {
        // It talks, so that only its not reading gives it away.
        say(wire::Body::Quality, [](auto& b) { return wire::CreateQuality(b, 1); });
        good.poll(1ms);
        good.send_pose(look_at({1, 1, 1}, {0, 0, 0}, 8, 8, 1));
        if (bus::now_ns() - published_ns < 20'000'000) return;
        published_ns = bus::now_ns();
        disturb(model, random);
        trainer_.publish(model);
      });
  EXPECT_TRUE(forgotten);
  EXPECT_EQ(good.replica().view().count, 3000U);
  EXPECT_FALSE(good.replica().needs_snapshot());
}

TEST_F(StreamerTest, AViewerThatFellSilentGoesOnWhereItWas) {
  start_streamer({{"viewer_timeout_s", "0.2"}});
  std::mt19937 random(17);
  GaussiansBuffer model = stream::test::toy_model(300, 1);
  trainer_.publish(model);
  StreamClient awake(client_options("awake")), sleeper(client_options("sleeper"));
  const auto keep_awake = [&] { awake.send_pose(look_at({1, 1, 1}, {0, 0, 0}, 8, 8, 1)), awake.poll(1ms); };
  ASSERT_TRUE(poll_until(
      [&] { return keep_awake(), awake.replica().view().count == 300 && sleeper.replica().view().count == 300; },
      sleeper));
  bus::Subscriber stats(observer_, {"stream/stats"});
  std::uint64_t snapshots = 0;
  ASSERT_TRUE(wait_message<wire::StreamStats>(
      stats, "StreamStats/1", [&](const auto& body) { return snapshots = body.snapshots(), body.viewers() == 1; },
      keep_awake));
  disturb(model, random);
  trainer_.publish(model);
  const auto caught_up = [&] {
    keep_awake();
    sleeper.send_pose(look_at({1, 1, 1}, {0, 0, 0}, 8, 8, 1));
    return sleeper.replica().held()->sequence > 1 &&
           sleeper.replica().held()->sequence == awake.replica().held()->sequence;
  };
  EXPECT_TRUE(poll_until(caught_up, sleeper));
  EXPECT_TRUE(sleeper.replica().held()->gaussians == awake.replica().held()->gaussians);
  EXPECT_TRUE(wait_message<wire::StreamStats>(
      stats, "StreamStats/1", [&](const auto& body) { return body.viewers() == 2 && body.snapshots() == snapshots; },
      [&] {
        keep_awake(), sleeper.send_pose(look_at({1, 1, 1}, {0, 0, 0}, 8, 8, 1)), sleeper.poll(1ms);
      }));
}

TEST_F(StreamerTest, ASecondStreamerOnTheSamePathIsRefused) {
  start_streamer();
  try {
    RunningStreamer second(connect("second"), {});
    FAIL() << "it bound a path that is taken";
  } catch (const bus::Error& error) {
    EXPECT_NE(std::string(error.what()).find("another streamer"), std::string::npos) << error.what();
  }
}

TEST_F(StreamerTest, ServesOverTcpTooAndRefusesMoreThanMaxViewers) {
  start_streamer({{"tcp", "tcp://127.0.0.1:*"}, {"max_viewers", "1"}});
  trainer_.publish(stream::test::toy_model(100, 1));
  viewer::ClientOptions options = client_options("remote");
  options.endpoint = streamer_->endpoints().at(1);
  StreamClient remote(options);
  ASSERT_TRUE(poll_until([&] { return remote.replica().view().count == 100; }, remote));
  StreamClient second(client_options("second"));
  ASSERT_TRUE(poll_until([&] { return second.received_bytes() > 0; }, remote, second));
  EXPECT_EQ(second.replica().view().count, 0U);
  EXPECT_FALSE(second.connected());
}

TEST_F(StreamerTest, AnEndpointThatCannotBeBoundIsNamed) {
  try {
    RunningStreamer broken(connect("broken"), {{"endpoint", "tcp://256.1.1.1:x"}});
    FAIL();
  } catch (const bus::Error& error) {
    EXPECT_NE(std::string(error.what()).find("256.1.1.1"), std::string::npos) << error.what();
  }
}

}  // namespace
}  // namespace splatbus::stream_test

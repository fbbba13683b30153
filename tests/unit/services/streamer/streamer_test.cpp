#include "streamer/streamer.h"

#include <gtest/gtest.h>

#include <map>
#include <random>

#include "bus/clock.h"
#include "bus/error.h"
#include "stream_fixture.h"
#include "wire/capture_generated.h"
#include "wire/viewer_generated.h"

namespace splatbus::stream_test {
namespace {

using namespace std::chrono_literals;
using viewer::StreamClient;

class StreamerTest : public StreamTest {
 protected:
  StreamerTest() : observer_(connect("observer")) {}

  /// The first message on a topic that the condition accepts.
  template <class T>
  static bool wait_message(bus::Subscriber& subscriber, const char* schema, const std::function<bool(const T&)>& accept,
                           const std::function<void()>& meanwhile = {}) {
    const auto deadline = std::chrono::steady_clock::now() + bus_test::patience;
    while (std::chrono::steady_clock::now() < deadline) {
      if (meanwhile) meanwhile();
      while (const auto message = subscriber.receive(1ms)) {
        if (accept(message->root<T>(schema))) return true;
      }
    }
    return false;
  }

  static void grow(GaussiansBuffer& model, std::size_t count, std::uint32_t seed) {
    const GaussiansBuffer more = stream::test::toy_model(model.count() + count, seed);
    const std::size_t before = model.count();
    GaussiansBuffer grown = more;
    for (int c = 0; c < model.layout().channels(); ++c) {
      for (std::size_t i = 0; i < before; ++i) {
        grown.parameters[static_cast<std::size_t>(c) * grown.stride() + i] =
            model.parameters[static_cast<std::size_t>(c) * model.stride() + i];
      }
    }
    model = grown;
  }

  static void disturb(GaussiansBuffer& model, std::mt19937& random) {
    std::normal_distribution<float> normal(0, 0.1F);
    for (float& value : model.parameters) value += normal(random);
  }

  std::shared_ptr<bus::Context> observer_;
};

TEST_F(StreamerTest, AViewerGetsTheModelAndFollowsIt) {
  start_streamer();
  GaussiansBuffer model = stream::test::toy_model(500, 1);
  trainer_.publish(model);
  StreamClient client(client_options("one"));
  ASSERT_TRUE(poll_until([&] { return client.replica().view().count == 500; }, client));
  grow(model, 300, 2);
  trainer_.publish(model);
  ASSERT_TRUE(poll_until([&] { return client.replica().view().count == 800; }, client));
  EXPECT_EQ(client.refused(), 0U);
  EXPECT_EQ(client.snapshot_requests(), 0U);
  // What it shows is what was published, to within the quantisers.
  const auto& held = *client.replica().held();
  ASSERT_TRUE(poll_until([&] { return held.gaussians.gaussian_id[799] != 0; }, client));
  std::map<std::uint64_t, std::size_t> column;
  for (std::size_t i = 0; i < 800; ++i) column[model.gaussian_id[i]] = i;
  for (std::size_t slot = 0; slot < 800; ++slot) {
    const std::size_t i = column.at(held.gaussians.gaussian_id[slot]);
    EXPECT_NEAR(client.replica().view().plane(0)[slot], model.parameters[i], 0.002F);
  }
}

TEST_F(StreamerTest, AModelThatIsPublishedBeforeStreamerAndViewerStartIsFound) {
  trainer_.publish(stream::test::toy_model(200, 1));
  start_streamer();
  StreamClient client(client_options("one"));
  EXPECT_TRUE(poll_until([&] { return client.replica().view().count == 200; }, client));
}

TEST_F(StreamerTest, ViewersThatJoinAtAnyTimeHoldTheSame) {
  start_streamer();
  std::mt19937 random(3);
  GaussiansBuffer model = stream::test::toy_model(400, 1);
  trainer_.publish(model);
  StreamClient first(client_options("first"));
  ASSERT_TRUE(poll_until([&] { return first.replica().view().count == 400; }, first));
  disturb(model, random);
  grow(model, 100, 4);
  trainer_.publish(model);
  ASSERT_TRUE(poll_until([&] { return first.replica().view().count == 500; }, first));
  StreamClient late(client_options("late"));
  ASSERT_TRUE(poll_until([&] { return late.replica().view().count == 500; }, first, late));
  for (int round = 0; round < 5; ++round) {
    disturb(model, random);
    trainer_.publish(model);
    const std::uint64_t before = first.replica().held()->sequence;
    ASSERT_TRUE(poll_until([&] { return first.replica().held()->sequence > before; }, first, late));
  }
  const auto equal = [&] {
    return late.replica().held()->sequence == first.replica().held()->sequence &&
           late.replica().held()->gaussians == first.replica().held()->gaussians;
  };
  EXPECT_TRUE(poll_until(equal, first, late));
}

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

TEST_F(StreamerTest, PosesProbesAndQualityReachTheBus) {
  start_streamer();
  bus::Subscriber poses(observer_, {"viewer/pose"}), probes(observer_, {"viewer/probe"}),
      qualities(observer_, {"viewer/quality"});
  StreamClient client(client_options("eye"));
  ASSERT_TRUE(poll_until([&] { return client.connected(); }, client));
  const Camera camera = look_at({1, 2, 3}, {0, 0, 0}, 64, 48, 1);
  EXPECT_TRUE(wait_message<wire::ViewerPose>(
      poses, "ViewerPose/1",
      [](const auto& body) { return body.viewer()->str() == "eye" && body.camera()->width() == 64; },
      [&] { client.send_pose(camera), client.poll(1ms); }));
  EXPECT_TRUE(wait_message<wire::ViewerProbe>(
      probes, "ViewerProbe/1", [](const auto& body) { return body.probe_id() == 42; },
      [&] { client.send_probe(42, camera), client.poll(1ms); }));
  EXPECT_TRUE(wait_message<wire::ViewerQuality>(
      qualities, "ViewerQuality/1",
      [](const auto& body) { return body.ssim() == 0.5F && body.viewer()->str() == "eye"; },
      [&] {
        client.send_quality(42, {30, 0.5, 0.1}, 7), client.poll(1ms);
      }));
}

TEST_F(StreamerTest, ProbePicturesReachThoseWhoWantThem) {
  start_streamer();
  viewer::ClientOptions wants = client_options("wants");
  wants.probes = true;
  StreamClient with(wants), without(client_options("without"));
  ASSERT_TRUE(poll_until([&] { return with.connected() && without.connected(); }, with, without));
  const Camera camera = look_at({1, 2, 3}, {0, 0, 0}, 16, 8, 1);
  const wire::Camera wired = to_wire(camera);
  std::vector<std::uint8_t> pixels(16 * 8 * 4);
  for (std::size_t i = 0; i < pixels.size(); ++i) pixels[i] = static_cast<std::uint8_t>(i);
  bus::Publisher publisher(observer_, "capture/probe");
  std::optional<viewer::ProbeAnswer> answer;
  Light light;
  light.generation = 3;
  const auto publish = [&](std::uint32_t width) {
    const bus::OutgoingTensor color{
        .name = "color", .shape = {8, width, 4}, .type = bus::ElementType::U8, .inline_data = pixels.data()};
    publisher.publish({.schema = "CaptureProbe/1", .tensors = {color}}, [&](auto& builder, auto header) {
      return wire::CreateCaptureProbe(builder, header, 9, 1, 0.5, &wired, to_wire(builder, ObjectTransforms{{3, {}}}),
                                      to_wire(builder, light));
    });
  };
  publish(15);  // a tensor that is not the camera's size is refused
  ASSERT_TRUE(
      poll_until([&] { return publish(16), answer = with.take_probe_answer(), answer.has_value(); }, with, without));
  EXPECT_EQ(answer->probe_id, 9U);
  EXPECT_EQ(answer->rgba, pixels);
  EXPECT_EQ(answer->scene.light.generation, 3U);
  EXPECT_EQ(answer->scene.objects.size(), 1U);
  EXPECT_FALSE(without.take_probe_answer());
}

TEST_F(StreamerTest, LightReachesTheViewer) {
  start_streamer();
  trainer_.publish(stream::test::toy_model(50, 1));
  StreamClient client(client_options("one"));
  ASSERT_TRUE(poll_until([&] { return client.replica().view().count == 50; }, client));
  Light light;
  light.generation = 12;
  light.sun_irradiance = {3, 2, 1};
  trainer_.publish_light(light);
  EXPECT_TRUE(poll_until([&] { return client.replica().scene().light.generation == 12; }, client));
  EXPECT_EQ(client.replica().scene().light.sun_irradiance, light.sun_irradiance);
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

TEST_F(StreamerTest, StatisticsAddUp) {
  start_streamer();
  trainer_.publish(stream::test::toy_model(500, 1));
  StreamClient client(client_options("one"));
  bus::Subscriber stats(observer_, {"stream/stats"});
  ASSERT_TRUE(wait_message<wire::StreamStats>(
      stats, "StreamStats/1", [](const auto& body) { return body.gaussians() == 500 && body.total_bytes() > 0; },
      [&] { client.poll(1ms); }));
  EXPECT_TRUE(wait_message<wire::StreamStats>(
      stats, "StreamStats/1",
      [&](const auto& body) {
        std::uint64_t sum = 0;
        for (const auto* type : *body.by_type()) sum += type->total_bytes();
        EXPECT_EQ(sum, body.total_bytes());
        EXPECT_EQ(body.viewers(), 1U);
        EXPECT_EQ(body.model_gaussians(), 500U);
        EXPECT_GT(body.wire_mbps_mean(), 0);
        return true;
      },
      [&] { client.poll(1ms); }));
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

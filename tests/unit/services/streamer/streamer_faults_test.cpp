// Losses, restarts, garbage and viewers that do not read.
#include <unistd.h>

#include <deque>
#include <fstream>

#include "bus/error.h"
#include "streamer_fixture.h"
#include "wire/viewer_generated.h"

namespace splatbus::stream_test {
namespace {

TEST_F(StreamerTest, WhatWasLostComesAgainAndNobodyElseNotices) {
  start_streamer();
  std::mt19937 random(5);
  GaussiansBuffer model = stream::test::toy_model(400, 1);
  trainer_.publish(model);
  StreamClient good(client_options("good")), lossy(client_options("lossy"));
  ASSERT_TRUE(poll_until([&] { return good.replica().count() == 400 && lossy.replica().count() == 400; }, good, lossy));
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
    const std::uint64_t before = good.received_bytes();
    ASSERT_TRUE(poll_until([&] { return good.received_bytes() > before + 1000; }, good, lossy));
  }
  EXPECT_TRUE(poll_until([&] { return hold_the_same(good.replica(), lossy.replica()); }, good, lossy));
  EXPECT_GT(lost, 5);
  EXPECT_GE(lossy.lost(), static_cast<std::uint64_t>(lost) / 2);
  EXPECT_EQ(good.lost(), 0U);
  EXPECT_EQ(good.lacked(), 0U);
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
                         [&](auto& b) { return wire::CreateHelloDirect(b, "x\n\x1b[31m", &wired, true, ~0U); })
                  .packet;
      for (int k = 0; k < 3 && round % 4 == 1; ++k)
        bytes[random() % bytes.size()] = static_cast<std::uint8_t>(random());
    }
    const auto flags = round % 5 == 0 ? zmq::send_flags::sndmore : zmq::send_flags::none;
    (void)hostile.send(zmq::buffer(bytes), flags);
    if (round % 5 == 0) (void)hostile.send(zmq::buffer(bytes), zmq::send_flags::none);
  }
  const std::vector<wire::SequenceRange> all{{0, ~std::uint64_t{0}}, {9, 3}};
  const auto held =
      writer.write(1, 0, wire::Body::Held, [&](auto& b) { return wire::CreateHeldDirect(b, ~0ULL, &all, ~0ULL, 0); });
  (void)hostile.send(zmq::buffer(held.packet), zmq::send_flags::none);
  StreamClient client(client_options("good"));
  EXPECT_TRUE(poll_until([&] { return client.replica().count() == 100; }, client));
  EXPECT_EQ(client.refused(), 0U);
  // All of it was counted or refused: nobody joined by it, and nobody else was served anything for it.
  bus::Subscriber stats(observer_, {"stream/stats"});
  EXPECT_TRUE(wait_message<wire::StreamStats>(
      stats, "StreamStats/2",
      [&](const auto& body) {
        return body.viewers() == 1 && body.whole_pages() > 0 && body.lost_packets() == 0 && body.lost_viewers() == 0;
      },
      [&] { client.poll(1ms); }));
}

/// The streamer in turns under the test's clock, and what it says of itself.
class SteppedStreamerTest : public StreamerTest {
 protected:
  void start(const std::vector<std::pair<std::string, std::string>>& changes) {
    stepped_ = std::make_unique<SteppedStreamer>(connect("streamer"), changes);
  }
  [[nodiscard]] viewer::ClientOptions options(const std::string& name) const {
    return {.endpoint = stepped_->endpoint(), .name = name, .hello_every_ns = 20'000'000, .pose_every_ns = 0};
  }
  /// Turns without time passing until the condition holds.
  template <class... Clients>
  bool settle(const std::function<bool()>& condition, Clients&... clients) {
    return poll_until([&] { return stepped_->turn(0), condition(); }, clients...);
  }
  /// What was sent has arrived.
  static void receive_all(StreamClient& client) {
    for (int quiet = 0; quiet < 8;) {
      const std::uint64_t before = client.received_bytes();
      client.poll(1ms);
      quiet = client.received_bytes() == before ? quiet + 1 : 0;
    }
  }
  /// The statistics of the `count`-th second from the first one asked for.
  struct Statistics {
    std::uint64_t total_bytes = 0, viewers = 0, whole_pages = 0, lost_viewers = 0;
  };
  Statistics statistics(std::uint64_t sequence) {
    Statistics found;
    EXPECT_TRUE(wait_message<wire::StreamStats>(stats_, "StreamStats/2", [&](const auto& body) {
      found = {body.total_bytes(), body.viewers(), body.whole_pages(), body.lost_viewers()};
      return body.header()->sequence() >= sequence;
    }));
    return found;
  }

  /// The first that speak of so many viewers.
  Statistics statistics_of(std::uint64_t viewers) {
    Statistics found;
    EXPECT_TRUE(wait_message<wire::StreamStats>(stats_, "StreamStats/2", [&](const auto& body) {
      found = {body.total_bytes(), body.viewers(), body.whole_pages(), body.lost_viewers()};
      return body.viewers() == viewers;
    }));
    return found;
  }

  bus::Subscriber stats_{observer_, {"stream/stats"}};
  std::unique_ptr<SteppedStreamer> stepped_;
};

TEST_F(SteppedStreamerTest, NoSecondHasMoreThanATenthAboveTheRateFromTheFirstPageOn) {
  start({{"viewer_kbps", "2000"}, {"tick_hz", "5"}});
  std::mt19937 random(3);
  GaussiansBuffer model = stream::test::toy_model(20'000, 1);
  trainer_.publish(model);
  StreamClient client(options("one"));
  ASSERT_TRUE(settle([&] { return client.connected() && client.received_bytes() > 0; }, client));
  std::deque<std::uint64_t> bytes;  // after each hundredth of a second
  std::uint64_t largest = 0;
  for (int hundredth = 0; hundredth < 500; ++hundredth) {
    if (hundredth % 20 == 0) {
      disturb(model, random);
      trainer_.publish(model);
    }
    stepped_->turn(0.01);
    client.send_pose(look_at({1, 1, 1}, {0, 0, 0}, 8, 8, 1));
    receive_all(client);
    bytes.push_back(client.received_bytes());
    if (bytes.size() <= 100) continue;
    largest = std::max(largest, bytes.back() - bytes.front());
    bytes.pop_front();
  }
  EXPECT_LE(largest, 250'000U * 11 / 10);
  EXPECT_GT(largest, 200'000U) << "the rate was not used";
}

/// Whether the model rests until the viewer is whole.
class JoiningViewerTest : public SteppedStreamerTest, public testing::WithParamInterface<bool> {};

TEST_P(JoiningViewerTest, IsWholeSoonAndHasItsOwnRateFromThenOn) {
  start({{"viewer_kbps", "800"}, {"join_kbps", "20000"}, {"tick_hz", "5"}});
  std::mt19937 random(3);
  GaussiansBuffer model = stream::test::toy_model(20'000, 1);
  trainer_.publish(model);
  StreamClient client(options("one"));
  ASSERT_TRUE(settle([&] { return client.connected() && client.received_bytes() > 0; }, client));
  bool rests = GetParam();  // else there is always more to send
  auto hundredth = [&, count = 0]() mutable {
    if (count++ % 20 == 0 && !rests) {
      disturb(model, random);
      trainer_.publish(model);
    }
    stepped_->turn(0.01);
    client.send_pose(look_at({1, 1, 1}, {0, 0, 0}, 8, 8, 1));
    receive_all(client);
  };
  int hundredths = 0;
  for (; client.replica().count() < 20'000 && hundredths < 300; ++hundredths) hundredth();
  const std::uint64_t whole_bytes = client.received_bytes();
  EXPECT_GT(whole_bytes, 200'000U);
  EXPECT_LT(hundredths, 100) << "at 800 kbit/s more than 2 s";
  for (int k = 0; k < 100; ++k) hundredth();  // what was made for the higher rate has gone
  rests = false;
  for (int second = 0; second < 4; ++second) {
    const std::uint64_t before = client.received_bytes();
    for (int k = 0; k < 100; ++k) hundredth();
    EXPECT_LE(client.received_bytes() - before, 110'000U) << "second " << second;
    if (second < 2) continue;  // how much of it deltas may have is found first
    EXPECT_GT(client.received_bytes() - before, 60'000U) << "second " << second << ": the rate was not used";
  }
}

INSTANTIATE_TEST_SUITE_P(OfAModelThat, JoiningViewerTest, testing::Bool(),
                         [](const auto& rests) { return rests.param ? "Rests" : "Changes"; });

TEST_F(SteppedStreamerTest, WhatARestingModelDidNotUseIsNotSpentLater) {
  start({{"viewer_kbps", "1000000"}, {"budget_kbps", "400"}, {"tick_hz", "10"}});
  std::mt19937 random(3);
  GaussiansBuffer model = stream::test::toy_model(20'000, 1);
  trainer_.publish(model);
  StreamClient client(options("one"));
  ASSERT_TRUE(settle([&] { return client.replica().count() == 20'000; }, client));
  const auto second = [&] {
    const std::uint64_t before = client.received_bytes();
    for (int k = 0; k < 10; ++k) {
      stepped_->turn(0.1);
      for (int quiet = 0; quiet < 20;) {
        const std::uint64_t bytes = client.received_bytes();
        client.poll(1ms);
        quiet = client.received_bytes() == bytes ? quiet + 1 : 0;
      }
    }
    return client.received_bytes() - before;
  };
  for (int k = 0; k < 5; ++k) (void)second();
  disturb(model, random);
  trainer_.publish(model);
  const std::uint64_t spent = second();
  EXPECT_GT(spent, 25'000U) << "nothing was sent";
  EXPECT_LT(spent, 75'000U) << "50,000 bytes are a second's";
}

TEST_F(SteppedStreamerTest, AViewerThatFellSilentGoesOnWhereItWas) {
  start({{"viewer_timeout_s", "2"}, {"tick_hz", "5"}, {"budget_kbps", "1000000"}, {"viewer_kbps", "1000000"}});
  std::mt19937 random(17);
  GaussiansBuffer model = stream::test::toy_model(300, 1);
  trainer_.publish(model);
  StreamClient awake(options("awake")), sleeper(options("sleeper"));
  const Camera camera = look_at({1, 1, 1}, {0, 0, 0}, 8, 8, 1);
  const auto holds = [](const StreamClient& client) { return client.replica().count() == 300; };
  ASSERT_TRUE(settle([&] { return holds(awake) && holds(sleeper); }, awake, sleeper));
  bus::Subscriber poses(observer_, {"viewer/pose"});
  const auto pose_arrives = [&](StreamClient& client) {
    return settle([&] { return client.send_pose(camera), poses.receive(1ms).has_value(); }, client);
  };
  ASSERT_TRUE(pose_arrives(awake));
  for (int tenth = 0; tenth < 30; ++tenth) {  // the sleeper says nothing for three seconds
    stepped_->turn(0.1);
    if (tenth % 10 == 9) {
      ASSERT_TRUE(pose_arrives(awake));
    }
  }
  const Statistics alone = statistics_of(1);
  EXPECT_EQ(alone.lost_viewers, 1U);
  disturb(model, random);
  trainer_.publish(model);
  const auto whole_of = [&](const Statistics& s) { return s.whole_pages; };
  ASSERT_TRUE(settle(
      [&] {
        sleeper.send_pose(camera);
        stepped_->turn(0.01);
        return sleeper.connected() && hold_the_same(sleeper.replica(), awake.replica()) &&
               ids_by_row(awake.replica(), model).size() > 150;
      },
      awake, sleeper));
  stepped_->turn(1);
  const Statistics both = statistics_of(2);
  EXPECT_EQ(whole_of(both), whole_of(alone)) << "it went on where it was";
}

std::size_t resident_bytes() {
  std::ifstream statm("/proc/self/statm");
  std::size_t pages = 0, resident = 0;
  statm >> pages >> resident;
  return resident * static_cast<std::size_t>(::sysconf(_SC_PAGESIZE));
}

TEST_F(SteppedStreamerTest, AViewerThatDoesNotReadCostsNoMemoryAndIsForgotten) {
  start({{"viewer_timeout_s", "5"},
         {"tick_hz", "100"},
         {"history_mb", "1"},
         {"budget_kbps", "1000000"},
         {"viewer_kbps", "1000000"}});
  std::mt19937 random(13);
  GaussiansBuffer model = stream::test::toy_model(3000, 1);
  trainer_.publish(model);
  StreamClient good(options("good"));
  zmq::context_t context;
  zmq::socket_t deaf(context, zmq::socket_type::dealer);
  deaf.set(zmq::sockopt::linger, 0);
  deaf.set(zmq::sockopt::rcvhwm, 1);
  deaf.set(zmq::sockopt::rcvbuf, 4096);
  deaf.connect(stepped_->endpoint());
  const stream::PacketWriter writer("deaf", 1);
  const auto say = [&](wire::Body body, auto build) {
    const auto packet = writer.write(good.replica().epoch(), 0, body, build);
    (void)deaf.send(zmq::buffer(packet.packet), zmq::send_flags::dontwait);
  };
  say(wire::Body::Hello, [](auto& b) { return wire::CreateHelloDirect(b, "deaf"); });
  ASSERT_TRUE(settle([&] { return good.replica().count() == 3000; }, good));
  say(wire::Body::Held, [](auto& b) { return wire::CreateHeldDirect(b, 1); });  // its last
  bus::Subscriber poses(observer_, {"viewer/pose"});
  const auto pose_of = [&](const std::string& name) {
    while (const auto message = poses.receive(1ms)) {
      if (message->root<wire::ViewerPose>("ViewerPose/1").viewer()->str() == name) return true;
    }
    return false;
  };
  const wire::Camera camera = to_wire(look_at({1, 1, 1}, {0, 0, 0}, 8, 8, 1));
  // The model never rests. What the deaf viewer's sockets hold of it is full before memory is looked at.
  constexpr std::uint64_t kWarmUpBytes = 6'000'000, kStreamedBytes = 18'000'000;
  std::size_t resident_before = 0;
  while (good.received_bytes() < kStreamedBytes) {
    say(wire::Body::Quality, [](auto& b) { return wire::CreateQuality(b, 1); });  // it is not silent
    disturb(model, random);
    trainer_.publish(model);
    const std::uint64_t received = good.received_bytes();
    ASSERT_TRUE(
        settle([&] { return good.received_bytes() > received + 1000 || (stepped_->turn(0.001), false); }, good));
    if (resident_before == 0 && good.received_bytes() > kWarmUpBytes) resident_before = resident_bytes();
  }
#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
  EXPECT_LT(resident_bytes(), resident_before + (kStreamedBytes - kWarmUpBytes) / 2) << "with 1 MB of history";
#endif
  std::uint64_t viewers = 2;
  const auto read_viewers = [&](std::chrono::milliseconds patience) {
    while (const auto message = stats_.receive(patience)) {
      viewers = message->root<wire::StreamStats>("StreamStats/2").viewers();
    }
    return viewers;
  };
  for (int second = 0; second < 20 && viewers == 2; ++second) {
    ASSERT_TRUE(settle(
        [&] {
          say(wire::Body::Pose, [&](auto& b) { return wire::CreatePose(b, &camera); });
          stepped_->turn(0.02);
          return pose_of("deaf") || read_viewers(0ms) == 1;
        },
        good));
    ASSERT_TRUE(settle(
        [&] {
          stepped_->turn(0.02);
          return good.send_pose(look_at({1, 1, 1}, {0, 0, 0}, 8, 8, 1)), pose_of("good");
        },
        good));
    stepped_->turn(1);
    read_viewers(20ms);
  }
  EXPECT_EQ(good.replica().count(), 3000U);
  EXPECT_EQ(good.lacked(), 0U);
  EXPECT_EQ(viewers, 1U);
}

TEST_F(StreamerTest, ASecondStreamerOnTheSamePathIsRefused) {
  start_streamer();
  try {
    RunningStreamer second(connect("second"), {{"endpoint", endpoint()}});
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
  ASSERT_TRUE(poll_until([&] { return remote.replica().count() == 100; }, remote));
  StreamClient second(client_options("second"));
  ASSERT_TRUE(poll_until([&] { return second.received_bytes() > 0; }, remote, second));
  EXPECT_EQ(second.replica().count(), 0U);
  EXPECT_FALSE(second.connected());
}

TEST_F(StreamerTest, AnEndpointThatCannotBeBoundIsNamed) {
  try {
    RunningStreamer broken(connect("broken"), {{"endpoint", "tcp://256.1.1.1:1"}});
    FAIL();
  } catch (const bus::Error& error) {
    EXPECT_NE(std::string(error.what()).find("256.1.1.1"), std::string::npos) << error.what();
  }
}

}  // namespace
}  // namespace splatbus::stream_test

#include "stream/follower.h"

#include <gmock/gmock.h>

#include "stream/bytes.h"
#include "toy_server.h"
#include "wire/convert.h"

namespace splatbus::stream {
namespace {

using test::ToyServer;
using testing::ElementsAre;

constexpr std::int64_t kMillisecond = 1'000'000, kSecond = 1000 * kMillisecond;

/// A streamer that says what the test wants, when it wants, and a follower under the test's clock.
class FollowerTest : public testing::Test {
 protected:
  explicit FollowerTest(FollowerOptions options = {.name = "viewer", .probes = true}) { start(std::move(options)); }

  void start(FollowerOptions options) { follower.emplace(std::move(options), now_ns); }

  bool give(const EncodedPacket& packet) { return follower->receive(packet.packet, packet.payload, now_ns); }
  void give(const std::vector<EncodedPacket>& packets) {
    for (const EncodedPacket& packet : packets) give(packet);
  }
  void give(const EncodedSnapshot& snapshot) {
    give(snapshot.head);
    give(snapshot.chunks);
    give(snapshot.tail);
  }
  void welcome(bool asks = false) {
    give(writer.write(77, 0, wire::Body::Welcome,
                      [&](auto& b) { return wire::CreateWelcome(b, wire::Appearance::Transfer, 0, 77, 5, asks); }));
  }
  void picture(std::uint64_t id) {
    const wire::Camera camera = to_wire(look_at({1, 2, 3}, {0, 0, 0}, 16, 8, 1));
    give(writer.write(
        77, 0, wire::Body::ProbePicture,
        [&](auto& b) { return wire::CreateProbePicture(b, id, &camera, 512, 0, to_wire(b, Light{})); },
        zstd_compress(Bytes(512), 1)));
  }
  /// What the follower says now, after `passed_ns`.
  std::vector<ParsedPacket> said(std::int64_t passed_ns = 0) {
    now_ns += passed_ns;
    std::vector<ParsedPacket> packets;
    while (const auto packet = follower->next_outgoing(now_ns)) packets.push_back(test::parse(*packet));
    return packets;
  }
  std::vector<wire::Body> bodies(std::int64_t passed_ns = 0) {
    std::vector<wire::Body> bodies;
    for (const ParsedPacket& packet : said(passed_ns)) bodies.push_back(packet.body());
    return bodies;
  }
  /// In which tenths of that many seconds, through which the streamer lives, it says that.
  std::vector<std::int64_t> times_of(wire::Body body, int seconds) {
    std::vector<std::int64_t> tenths;
    for (int tenth = 0; tenth < 10 * seconds; ++tenth) {
      for (const wire::Body said : bodies(tenth > 0 ? kSecond / 10 : 0)) {
        if (said == body) tenths.push_back(tenth);
      }
      give(writer.write(77, 0, wire::Body::Keepalive, [](auto& b) { return wire::CreateKeepalive(b); }));
    }
    return tenths;
  }

  std::int64_t now_ns = 0;
  PacketWriter writer{"streamer", 1};
  std::optional<Follower> follower;
};

TEST_F(FollowerTest, SaysHelloAtOnceAndUntilItIsWelcome) {
  EXPECT_THAT(bodies(), ElementsAre(wire::Body::Hello));
  EXPECT_THAT(bodies(199 * kMillisecond), ElementsAre());
  EXPECT_THAT(bodies(kMillisecond), ElementsAre(wire::Body::Hello));
  EXPECT_FALSE(follower->connected());
  welcome();
  EXPECT_TRUE(follower->connected());
  EXPECT_THAT(bodies(kSecond), ElementsAre());
  // A long way off, a second Hello leaves before the first one's answer is there.
  welcome();
  EXPECT_TRUE(follower->connected());
}

TEST_F(FollowerTest, WhenItIsAskedItSaysHelloOnce) {
  bodies();
  welcome();
  now_ns += kSecond;
  welcome(true);
  welcome(true);
  EXPECT_FALSE(follower->connected());
  EXPECT_THAT(bodies(), ElementsAre(wire::Body::Hello));
  welcome();
  EXPECT_TRUE(follower->connected());
}

TEST_F(FollowerTest, AfterSilenceItGreetsWithWhatItHoldsAndKeepsShowingIt) {
  ToyServer server(1, 300);
  bodies();
  welcome();
  give(server.stream.snapshot());
  server.train(0.05F);
  give(server.tick());
  const std::uint64_t sequence = follower->replica().held()->sequence;
  ASSERT_GT(sequence, 0U);
  EXPECT_THAT(bodies(3 * kSecond), ElementsAre());
  const auto greeting = said(1);
  ASSERT_EQ(greeting.size(), 1U);
  ASSERT_EQ(greeting[0].body(), wire::Body::Hello);
  EXPECT_EQ(greeting[0].root().body_as_Hello()->holds(), sequence);
  EXPECT_EQ(greeting[0].stream_epoch(), 77U);
  EXPECT_EQ(follower->replica().count(), 300U);
}

TEST_F(FollowerTest, ANewConnectionIsGreetedAtOnce) {
  bodies();
  welcome();
  follower->set_camera(look_at({1, 1, 1}, {0, 0, 0}, 8, 8, 1));
  follower->restart();
  EXPECT_FALSE(follower->connected());
  const auto greeting = said();
  ASSERT_EQ(greeting.size(), 1U);
  EXPECT_EQ(greeting[0].root().body_as_Hello()->camera()->width(), 8U);
}

TEST_F(FollowerTest, AsksAgainForWhatIsMissingFourTimesASecond) {
  ToyServer server(2, 300);
  bodies();
  welcome();
  give(server.stream.snapshot());
  std::vector<EncodedPacket> lost;
  for (int k = 0; k < 3; ++k) {
    server.train(0.05F);
    const auto packets = server.tick();
    if (k < 2) {
      lost.insert(lost.end(), packets.begin(), packets.end());
    } else {
      give(packets);
    }
  }
  const std::uint64_t held = follower->replica().held()->sequence;
  const auto request = said();
  ASSERT_EQ(request.size(), 1U);
  ASSERT_EQ(request[0].body(), wire::Body::Resend);
  EXPECT_EQ(request[0].root().body_as_Resend()->first(), held + 1);
  EXPECT_EQ(request[0].root().body_as_Resend()->last(), held + lost.size());
  EXPECT_THAT(bodies(249 * kMillisecond), ElementsAre());
  EXPECT_THAT(bodies(kMillisecond), ElementsAre(wire::Body::Resend));
  give(lost);
  EXPECT_THAT(bodies(kSecond), ElementsAre());
  EXPECT_TRUE(follower->replica().held()->gaussians == server.stream.held().gaussians);
  EXPECT_EQ(follower->resends(), 2U);
}

TEST_F(FollowerTest, AModelThatIsTooLargeIsRefusedWithItsReasonAndAskedForEverMoreSeldom) {
  start({.name = "viewer", .max_gaussians = 299});
  ToyServer server(3, 300);
  bodies();
  welcome();
  const EncodedPacket begin = server.stream.snapshot().head.front();
  ASSERT_EQ(begin.body, wire::Body::SnapshotBegin);
  EXPECT_THROW(give(begin), StreamError);
  std::vector<int> asked;
  for (int second = 0; second < 120; ++second) {
    for (const ParsedPacket& packet : said(second > 0 ? kSecond : 0)) {
      ASSERT_EQ(packet.body(), wire::Body::NeedSnapshot);
      EXPECT_NE(packet.root().body_as_NeedSnapshot()->reason()->str().find("300 Gaussians"), std::string::npos);
      asked.push_back(second);
      EXPECT_THROW(give(begin), StreamError) << "a streamer that knows no bound";
    }
    welcome();  // it is not silent
  }
  EXPECT_THAT(asked, ElementsAre(0, 2, 6, 14, 30, 62));
  EXPECT_EQ(follower->refused(), 7U);
  // A smaller one is taken, and ends it.
  give(ToyServer(4, 20).stream.snapshot());
  EXPECT_FALSE(follower->replica().needs_snapshot());
  for (int second = 0; second < 100; ++second) {
    EXPECT_THAT(bodies(kSecond), ElementsAre());
    welcome();
  }
}

TEST_F(FollowerTest, ASnapshotThatStopsIsAskedForAgain) {
  ToyServer server(5, 600);
  bodies();
  welcome();
  give(server.stream.snapshot().head);
  EXPECT_TRUE(follower->replica().loading());
  EXPECT_THAT(times_of(wire::Body::NeedSnapshot, 11), ElementsAre(31, 62, 102));
}

TEST_F(FollowerTest, TellsWhereTheCameraIsTenTimesASecondWhileItMovesAndOnceWhileItRests) {
  bodies();
  welcome();
  Camera camera = look_at({1, 2, 3}, {0, 0, 0}, 64, 48, 1);
  std::vector<std::int64_t> poses;
  for (std::int64_t ms = 0; ms < 3000; ms += 20) {  // fifty pictures a second
    if (ms < 1000) camera.world_from_camera.translation.x += 0.01F;
    follower->set_camera(camera);
    for (const ParsedPacket& packet : said(ms > 0 ? 20 * kMillisecond : 0)) {
      ASSERT_EQ(packet.body(), wire::Body::Pose);
      EXPECT_EQ(packet.root().body_as_Pose()->camera()->world_from_camera().translation().x(),
                camera.world_from_camera.translation.x);
      poses.push_back(ms);
    }
  }
  EXPECT_THAT(poses, ElementsAre(0, 100, 200, 300, 400, 500, 600, 700, 800, 900, 1000, 2000));
}

TEST_F(FollowerTest, ACameraThatNobodyMovesIsNotRepeated) {
  bodies();
  welcome();
  follower->set_camera(look_at({1, 2, 3}, {0, 0, 0}, 64, 48, 1));
  EXPECT_THAT(bodies(), ElementsAre(wire::Body::Pose));
  EXPECT_THAT(bodies(2 * kSecond), ElementsAre()) << "whoever draws no more falls silent";
}

TEST_F(FollowerTest, PicturesThatNobodyTakesAreBoundedInBytes) {
  start({.name = "viewer", .probes = true, .held_picture_bytes = 1100});
  for (std::uint64_t id = 1; id <= 5; ++id) picture(id);
  EXPECT_TRUE(follower->take_notice());
  EXPECT_FALSE(follower->take_notice());
  EXPECT_EQ(follower->take_probe_answer()->probe_id, 1U);
  picture(6);
  EXPECT_EQ(follower->take_probe_answer()->probe_id, 2U);
  EXPECT_EQ(follower->take_probe_answer()->probe_id, 6U);
  EXPECT_FALSE(follower->take_probe_answer());
  EXPECT_EQ(follower->refused(), 0U);
}

TEST_F(FollowerTest, PicturesThatWereNotWantedAreIgnored) {
  start({.name = "viewer", .probes = false});
  picture(1);
  EXPECT_FALSE(follower->take_probe_answer());
}

TEST_F(FollowerTest, MeasuresHowLongScenesTook) {
  now_ns = 1000 * kSecond;
  start({.name = "viewer"});
  StreamModel model(writer, 77);
  ASSERT_TRUE(model.observe(GaussiansBuffer(ParameterLayout{}).view()));
  SceneState scene{.light = {}, .objects = {}, .version = 1};
  EXPECT_TRUE(model.take_scene(scene, {.capture_ns = 1}).empty());
  model.reset_to_target();
  give(model.snapshot().head);
  EXPECT_EQ(follower->scene_delays().count(), 0U) << "a snapshot's scene is old";
  for (int k = 1; k <= 200; ++k) {
    ++scene.version;
    const std::int64_t delay_ns = (k % 2 ? k : 201 - k) * kMillisecond;
    give(model.take_scene(scene, {.capture_ns = now_ns - delay_ns}));
  }
  EXPECT_EQ(follower->replica().scene_version(), 201U);
  EXPECT_EQ(follower->scene_delays().count(), 200U);
  EXPECT_DOUBLE_EQ(follower->scene_delays().quantile(0.5), 99);
  EXPECT_DOUBLE_EQ(follower->scene_delays().quantile(0.99), 197);
}

}  // namespace
}  // namespace splatbus::stream

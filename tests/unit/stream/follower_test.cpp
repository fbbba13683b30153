#include "stream/follower.h"

#include <gmock/gmock.h>

#include <map>

#include "../nanoseconds.h"
#include "expectations.h"
#include "stream/bytes.h"
#include "toy_server.h"
#include "wire/convert.h"

namespace splatbus::stream {
namespace {

using test::ToyServer;
using testing::Contains;
using testing::ElementsAre;
using testing::Not;

/// A streamer that says what the test wants, when it wants, and a follower under the test's clock.
class FollowerTest : public testing::Test {
 protected:
  explicit FollowerTest(FollowerOptions options = {.name = "viewer", .probes = true}) { start(std::move(options)); }

  void start(FollowerOptions options) { follower.emplace(std::move(options), now_ns); }

  bool give(const EncodedPacket& packet) { return follower->receive(packet.packet, packet.payload, now_ns); }
  void give(const std::vector<EncodedPacket>& packets) {
    for (const EncodedPacket& packet : packets) give(packet);
  }
  /// All that there is, to somebody who holds nothing.
  void join(ToyServer& server) {
    give(server.stream.layout_packet());
    give(*server.stream.scene_packet());
    give(server.stream.manifest_packets(*server.stream.offered(), {}, true));
    for (const OfferedPage& page : *server.stream.offered()) {
      for (const PagePacket& part : server.stream.page_packets(page.page)) give(part.packet);
    }
  }
  void welcome(bool asks = false, std::uint64_t connection = 1) {
    give(writer.write(77, 0, wire::Body::Welcome, [&](auto& b) {
      return wire::CreateWelcome(b, wire::Appearance::Transfer, 0, 77, 5, asks, connection);
    }));
  }
  /// A packet that says nothing, as the n-th of the connection.
  void number(std::uint64_t n) {
    EncodedPacket packet = writer.write(77, 0, wire::Body::Keepalive, [](auto& b) { return wire::CreateKeepalive(b); });
    set_sequence(packet, n);
    give(packet);
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
  std::int64_t now_ns = 0;
  PacketWriter writer{"streamer", 1};
  std::optional<Follower> follower;
};

TEST_F(FollowerTest, SaysHelloAtOnceAndUntilItIsWelcome) {
  EXPECT_THAT(bodies(), ElementsAre(wire::Body::Hello));
  EXPECT_THAT(bodies(199 * kMs), ElementsAre());
  EXPECT_THAT(bodies(kMs), ElementsAre(wire::Body::Hello));
  EXPECT_FALSE(follower->connected());
  welcome();
  EXPECT_TRUE(follower->connected());
  // A long way off, a second Hello leaves before the first one's answer is there.
  welcome();
  EXPECT_TRUE(follower->connected());
}

TEST_F(FollowerTest, WhenItIsAskedItSaysHelloOnce) {
  bodies();
  welcome();
  bodies(kSecond);
  welcome(true);
  welcome(true);
  EXPECT_FALSE(follower->connected());
  EXPECT_THAT(bodies(), ElementsAre(wire::Body::Hello));
  welcome();
  EXPECT_TRUE(follower->connected());
}

TEST_F(FollowerTest, AfterSilenceItGreetsWithWhatItHoldsAndKeepsShowingIt) {
  start({.name = "viewer", .max_gaussians = 5000});
  ToyServer server(1, 1500);
  bodies();
  welcome();
  join(server);
  EXPECT_THAT(bodies(3 * kSecond), ElementsAre(wire::Body::Held));
  const auto greeting = said(1);
  ASSERT_EQ(greeting.size(), 1U);
  ASSERT_EQ(greeting[0].body(), wire::Body::Hello);
  const wire::Hello& hello = *greeting[0].root().body_as_Hello();
  EXPECT_EQ(greeting[0].stream_epoch(), server.stream.held().epoch);
  EXPECT_EQ(hello.max_gaussians(), 5000U);
  EXPECT_EQ(hello.scene_version(), 1U);
  std::map<std::uint32_t, std::uint32_t> held, offered;
  for (const wire::PageVersion* page : *hello.held()) held.emplace(page->page(), page->version());
  for (const OfferedPage& page : *server.stream.offered()) offered.emplace(page.page, page.version);
  EXPECT_GT(offered.size(), 1U);
  EXPECT_EQ(held, offered);
  EXPECT_EQ(follower->replica().count(), 1500U);
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

TEST_F(FollowerTest, SaysFourTimesASecondWhatHasCome) {
  bodies();
  welcome();
  said(kSecond);
  const std::uint64_t before = follower->received_bytes();
  number(1);
  number(2);
  EXPECT_THAT(bodies(249 * kMs), ElementsAre());
  const auto report = said(kMs);
  ASSERT_EQ(report.size(), 1U);
  ASSERT_EQ(report[0].body(), wire::Body::Held);
  const wire::Held& held = *report[0].root().body_as_Held();
  EXPECT_EQ(held.newest(), 2U);
  EXPECT_EQ(held.missing()->size(), 0U);
  EXPECT_EQ(held.bytes(), follower->received_bytes() - before);
  EXPECT_EQ(held.window_us(), 250'000U);
  EXPECT_THAT(bodies(kSecond), ElementsAre()) << "nothing has come";
}

TEST_F(FollowerTest, WhatDidNotComeIsSaidAtOnceAndOnce) {
  bodies();
  welcome();
  number(1);
  said(kSecond);
  number(5);
  const auto report = said(50 * kMs);
  ASSERT_EQ(report.size(), 1U);
  const wire::Held& held = *report[0].root().body_as_Held();
  ASSERT_EQ(held.missing()->size(), 1U);
  EXPECT_EQ(held.missing()->Get(0)->first(), 2U);
  EXPECT_EQ(held.missing()->Get(0)->last(), 4U);
  EXPECT_EQ(follower->lost(), 3U);
  number(6);
  EXPECT_THAT(bodies(249 * kMs), ElementsAre());
  const auto next = said(kMs);
  ASSERT_EQ(next.size(), 1U);
  EXPECT_EQ(next[0].root().body_as_Held()->missing()->size(), 0U);
  // Another connection begins anew.
  welcome(false, 2);
  number(1);
  EXPECT_EQ(said(250 * kMs).at(0).root().body_as_Held()->newest(), 1U);
  EXPECT_EQ(follower->lost(), 3U);
}

TEST_F(FollowerTest, APageOfWhichADeltaWasLostIsAskedForAgain) {
  ToyServer server(2, 300);
  bodies();
  welcome();
  join(server);
  said(kSecond);
  const std::uint32_t version = follower->replica().held().pages.begin()->second.version;
  server.train(0.05F);
  server.tick();  // lost
  server.train(0.05F);
  give(server.tick());
  const auto report = said(50 * kMs);
  ASSERT_EQ(report.size(), 1U);
  const auto* lacks = report[0].root().body_as_Held()->lacks();
  ASSERT_GT(lacks->size(), 0U);
  EXPECT_EQ(lacks->Get(0)->version(), version);
  EXPECT_EQ(follower->lacked(), lacks->size());
  join(server);
  EXPECT_EQ(follower->replica().missing_pages(), 0U);
  test::expect_exact(server.stream, follower->replica());
}

TEST_F(FollowerTest, PagesForWhichThereIsNoRoomAreGivenBack) {
  start({.name = "viewer", .max_gaussians = 1200});
  ToyServer server(3, 3000);
  bodies();
  welcome();
  join(server);
  EXPECT_LE(follower->replica().count(), 1200U);
  EXPECT_GT(follower->replica().count(), 0U);
  const auto report = said(kSecond);
  ASSERT_EQ(report.size(), 1U);
  const wire::Held& held = *report[0].root().body_as_Held();
  EXPECT_EQ(held.dropped()->size(), follower->replica().missing_pages());
  EXPECT_EQ(held.gaussians(), follower->replica().count());
  EXPECT_EQ(follower->refused(), 0U);
}

TEST_F(FollowerTest, TellsWhereTheCameraIsTenTimesASecondWhileItMovesAndOnceWhileItRests) {
  bodies();
  welcome();
  Camera camera = look_at({1, 2, 3}, {0, 0, 0}, 64, 48, 1);
  std::vector<std::int64_t> poses;
  for (std::int64_t ms = 0; ms < 3000; ms += 20) {  // fifty pictures a second
    if (ms < 1000) camera.world_from_camera.translation.x += 0.01F;
    follower->set_camera(camera);
    for (const ParsedPacket& packet : said(ms > 0 ? 20 * kMs : 0)) {
      if (packet.body() != wire::Body::Pose) continue;
      EXPECT_EQ(packet.root().body_as_Pose()->camera()->world_from_camera().translation().x(),
                camera.world_from_camera.translation.x);
      poses.push_back(ms);
    }
  }
  EXPECT_THAT(poses, ElementsAre(0, 100, 200, 300, 400, 500, 600, 700, 800, 900, 1000, 2000));
}

TEST_F(FollowerTest, AWallOfScreensIsToldAsTheSameViewInFewerPixels) {
  follower->set_camera(look_at({1, 2, 3}, {0, 0, 0}, 11520, 2160, 1));
  const auto packets = said();
  ASSERT_EQ(packets.size(), 1U);
  const Camera told = from_wire(*packets.front().root().body_as_Hello()->camera());
  EXPECT_EQ(told.width, 8192U);
  const Camera same = look_at({1, 2, 3}, {0, 0, 0}, 8192, 1536, 1);
  EXPECT_EQ(told.height, same.height);
  EXPECT_NEAR(told.fx, same.fx, 0.1F);
  EXPECT_NEAR(told.cy, same.cy, 0.1F);
}

TEST_F(FollowerTest, ACameraThatNobodyMovesIsNotRepeated) {
  bodies();
  welcome();
  follower->set_camera(look_at({1, 2, 3}, {0, 0, 0}, 64, 48, 1));
  EXPECT_THAT(bodies(), Contains(wire::Body::Pose));
  EXPECT_THAT(bodies(2 * kSecond), Not(Contains(wire::Body::Pose))) << "whoever draws no more falls silent";
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
  ToyServer server(6, 20);
  join(server);
  EXPECT_EQ(follower->scene_delays().count(), 0U) << "the first scene is old";
  for (int k = 1; k <= 200; ++k) {
    ++server.scene.version;
    const std::int64_t delay_ns = (k % 2 ? k : 201 - k) * kMs;
    give(*server.stream.take_scene(server.scene, {.capture_ns = now_ns - delay_ns}));
  }
  EXPECT_EQ(follower->replica().scene_version(), 201U);
  EXPECT_EQ(follower->scene_delays().count(), 200U);
  EXPECT_DOUBLE_EQ(follower->scene_delays().quantile(0.5), 99);
  EXPECT_DOUBLE_EQ(follower->scene_delays().quantile(0.99), 197);
}

}  // namespace
}  // namespace splatbus::stream

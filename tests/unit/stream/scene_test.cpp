// Scenes on their way to viewers: what they lose, what they cost, and what is refused.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <glm/gtc/constants.hpp>
#include <limits>
#include <map>
#include <random>
#include <string>

#include "expectations.h"
#include "scene_expectations.h"
#include "stream/scene_codec.h"
#include "toy_server.h"

namespace splatbus::stream {
namespace {

using test::expect_scene_near;
using test::join;
using test::parse;
using test::send;
using test::ToyServer;

constexpr std::size_t kFramingBytes = 9;  // ZMTP's, of a frame above 255 bytes

glm::quat random_rotation(std::mt19937& random) {
  std::normal_distribution<float> normal(0, 1);
  return glm::normalize(glm::quat(normal(random), normal(random), normal(random), normal(random)));
}

/// The sun turns by 15 degrees a second, a ball bounces and a cube turns, 30 times a second.
void live(SceneState& scene, int frame) {
  const float t = static_cast<float>(frame) / 30;
  const float azimuth = glm::radians(15 * t);
  scene.light.generation = static_cast<std::uint64_t>(frame) + 1;
  scene.light.sun_direction = glm::normalize(glm::vec3(std::cos(azimuth), 1.2F, std::sin(azimuth)));
  scene.objects[1].rigid.translation = {2 * std::sin(t), std::abs(2 * std::sin(3 * t)), 2 * std::cos(t)};
  scene.objects[1].rigid.rotation = glm::angleAxis(5 * t, glm::normalize(glm::vec3(1, 0.2F, 0)));
  scene.objects[2].rigid.translation = {1, 0.5F, -1};
  scene.objects[2].rigid.rotation = glm::angleAxis(t, glm::vec3(0, 1, 0));
}

TEST(Scene, EachValueIsWithinWhatIsStated) {
  std::mt19937 random(1);
  std::normal_distribution<float> normal(0, 1);
  for (int round = 0; round < 2000; ++round) {
    SceneState scene;
    scene.version = 1;
    scene.light.generation = random();
    scene.light.sun_direction = glm::normalize(glm::vec3(normal(random), normal(random), normal(random)));
    const float bright = std::exp(5 * normal(random));
    for (glm::vec3& c : scene.light.ambient_sh) c = bright * glm::vec3(normal(random), normal(random), normal(random));
    scene.light.sun_irradiance = bright * glm::abs(glm::vec3(normal(random), normal(random), normal(random)));
    scene.light.background = glm::abs(glm::vec3(normal(random), 0, 1e-4F));
    scene.objects[static_cast<std::uint32_t>(random())].rigid = {random_rotation(random),
                                                                 100.0F * glm::vec3(normal(random), normal(random), 0)};
    const QuantizedScene sent = quantize_scene(scene);
    const QuantizedScene received = decode_scene(encode_scene(sent, nullptr), nullptr, 1);
    ASSERT_TRUE(received == sent);
    expect_scene_near(dequantize_scene(received), scene);
    if (HasFailure()) return;
  }
}

TEST(Scene, IsFollowedThroughObjectsThatComeMoveAndGo) {
  ToyServer server(2);
  Replica replica;
  join(server.stream, replica);
  std::mt19937 random(2);
  for (int frame = 0; frame < 400; ++frame) {
    live(server.scene, frame);
    const std::uint32_t id = random() % 4 == 0 ? 0xFFFFFFFFU - random() % 3 : 5 + random() % 10;
    if (random() % 3 == 0) {
      server.scene.objects.erase(id);
    } else {
      server.scene.objects[id].rigid.translation.x += 0.01F;
    }
    if (random() % 5 == 0) server.scene.light.ambient_sh[random() % 9].y += 0.1F;
    send(server.change_scene(), replica);
    ASSERT_FALSE(replica.report().urgent());
    expect_scene_near(replica.scene(), server.scene);
    EXPECT_EQ(replica.scene_version(), server.scene.version);
    EXPECT_EQ(replica.scene_instant(), (SceneInstant{server.scene.version, 5}));
    if (frame % 50 == 0) {
      Replica late;
      join(server.stream, late);
      expect_scene_near(late.scene(), server.scene);
      EXPECT_TRUE(late.held().quantized_scene == replica.held().quantized_scene);
      server.scene.objects[77].rigid.translation.y += 1;
      const auto next = server.change_scene();
      send(next, replica);
      send(next, late);
      expect_scene_near(late.scene(), server.scene);
    }
    if (HasFailure()) return;
  }
}

TEST(Scene, ASunAndTwoObjectsStayWithin60KbitASecond) {
  for (const bool day : {false, true}) {
    ToyServer server(3);
    std::size_t bytes = 0;
    for (int frame = 0; frame < 300; ++frame) {
      live(server.scene, frame);
      if (day) {
        const float dim = 1 + static_cast<float>(frame) / 300;
        server.scene.light.sun_irradiance = glm::vec3(3, 2.5F, 2) * dim;
        server.scene.light.background = glm::vec3(0.3F, 0.5F, 0.9F) * dim;
        for (glm::vec3& c : server.scene.light.ambient_sh) c = glm::vec3(1, 0.9F, 0.7F) * dim;
      }
      const auto packets = server.change_scene();
      ASSERT_EQ(packets.size(), 1U);
      ASSERT_EQ(packets[0].body, wire::Body::Scene);
      EXPECT_LE(packets[0].bytes() + kFramingBytes, 250U + (frame == 0 ? 100 : 0)) << frame;
      bytes += packets[0].bytes() + kFramingBytes;
    }
    const double kbps = static_cast<double>(bytes) * 8 / 10 / 1000;
    RecordProperty(day ? "kbps_day" : "kbps", std::to_string(kbps));
    EXPECT_LE(kbps, 60) << (day ? "all of the light changes" : "the sun turns");
  }
}

TEST(Scene, WhatDoesNotChangeIsNotSent) {
  ToyServer server(4);
  for (int i = 0; i < 1000; ++i) server.scene.objects[static_cast<std::uint32_t>(i)].rigid.translation.x = 1;
  const std::size_t all = server.change_scene().at(0).bytes();
  server.scene.objects[500].rigid.translation.x = 2;
  EXPECT_LT(server.change_scene().at(0).bytes(), 185U);
  EXPECT_GT(all, 10'000U);
  // The same version again says nothing.
  EXPECT_FALSE(server.stream.take_scene(server.scene, {}));
}

TEST(Scene, AnObjectThatVanishesIsGoneWithThePacketThatSaysSo) {
  ToyServer server(5);
  server.scene.objects[7].rigid.translation = {1, 0, 0};
  server.scene.objects[8].rigid.translation = {2, 0, 0};
  (void)server.change_scene();
  Replica replica;
  join(server.stream, replica);
  ASSERT_TRUE(replica.scene().objects.contains(7));
  server.scene.objects.erase(7);
  const auto packets = server.change_scene();
  ASSERT_EQ(packets.size(), 1U);
  EXPECT_TRUE(replica.receive(parse(packets[0])));
  EXPECT_FALSE(replica.scene().objects.contains(7));
  EXPECT_TRUE(replica.scene().objects.contains(8));
  EXPECT_EQ(replica.count(), 600U) << "its Gaussians stay";
}

TEST(Scene, AfterOneThatIsLostAWholeOneHelpsAndNothingIsShownThatIsHalfTrue) {
  ToyServer server(6);
  Replica replica;
  join(server.stream, replica);
  std::vector<EncodedPacket> packets;
  for (int frame = 0; frame < 5; ++frame) {
    live(server.scene, frame);
    packets.push_back(server.change_scene().at(0));
  }
  for (const std::size_t arrives : {0U, 3U, 4U}) replica.receive(parse(packets[arrives]));
  EXPECT_EQ(replica.scene_version(), 2U);
  EXPECT_TRUE(replica.report().scene_lost);
  send(server.stream.scene_packet(), replica);
  EXPECT_EQ(replica.scene_version(), 6U);
  expect_scene_near(replica.scene(), server.scene);
}

std::string refusal(const std::function<void()>& action) {
  try {
    action();
  } catch (const StreamError& error) {
    return error.what();
  }
  return "nothing was refused";
}

TEST(Scene, AStreamerRefusesByNameWhatIsNoScene) {
  ToyServer server(7);
  Replica replica;
  join(server.stream, replica);
  live(server.scene, 1);
  send(server.change_scene(), replica);
  const auto expect_refused = [&](const std::string& word, auto&& spoil) {
    SceneState bad = server.scene;
    bad.version += 1;
    spoil(bad);
    const std::string why = refusal([&] { (void)server.stream.take_scene(bad, {}); });
    EXPECT_NE(why.find(word), std::string::npos) << why;
  };
  const float nan = std::nanf(""), infinity = std::numeric_limits<float>::infinity();
  expect_refused("object 1: position", [&](SceneState& s) { s.objects[1].rigid.translation.y = nan; });
  expect_refused("object 1: rotation", [&](SceneState& s) { s.objects[1].rigid.rotation = {0, 0, 0, 0}; });
  expect_refused("object 2: rotation", [&](SceneState& s) { s.objects[2].rigid.rotation.x = nan; });
  expect_refused("sun_direction", [&](SceneState& s) { s.light.sun_direction = {nan, 0, 0}; });
  expect_refused("sun_irradiance", [&](SceneState& s) { s.light.sun_irradiance.z = infinity; });
  expect_refused("ambient_sh", [&](SceneState& s) { s.light.ambient_sh[4].x = nan; });
  expect_refused("background", [&](SceneState& s) { s.light.background.x = nan; });
  expect_refused("version 1 after 2", [&](SceneState& s) { s.version = 1; });
  expect_refused("version 0", [&](SceneState& s) { s.version = 0; });
  expect_refused("32772 objects", [&](SceneState& s) {
    for (std::uint32_t i = 0; i < kMaxObjects + 3; ++i) s.objects[i];
  });
  // The stream goes on, and what lies too far away for any picture is brought nearer.
  server.scene.objects[1].rigid.translation.x = -3e30F;
  send(server.change_scene(), replica);
  EXPECT_EQ(replica.scene().objects.at(1).rigid.translation.x, -2'097'152.0F);
}

/// A viewer that holds objects 1 and 2, and forged bytes.
class ForgedScene : public testing::Test {
 protected:
  ForgedScene() {
    live(server_.scene, 1);
    (void)server_.change_scene();
    join(server_.stream, replica_);
  }

  /// What a viewer says to a delta of version 9, or another.
  std::string apply(const Bytes& state, std::uint64_t version = 9, bool whole = false) {
    ReplicatedState held = replica_.held();
    const std::string why = refusal([&] {
      stream::apply(held, parse(writer_.write(77, 0, wire::Body::Scene, [&](auto& b) {
                      return wire::CreateScene(b, version, whole ? 0 : 2, 1, b.CreateVector(state));
                    })));
    });
    EXPECT_EQ(held.scene.version, why == "nothing was refused" ? version : 2);
    EXPECT_TRUE(why == "nothing was refused" || held.quantized_scene == replica_.held().quantized_scene);
    return why;
  }
  void expect_refused(const std::string& word, const Bytes& state) {
    const std::string why = apply(state);
    EXPECT_TRUE(why.starts_with("Scene") && why.find(word) != std::string::npos) << why;
  }

  ToyServer server_{8};
  Replica replica_;
  PacketWriter writer_{"streamer", 1};
};

TEST_F(ForgedScene, IsRefusedByName) {
  EXPECT_EQ(apply({0, 0, 0, 0}), "nothing was refused");
  EXPECT_EQ(apply({0, 0, 0, 0}, 1), "Scene: version 1 where 2 is held");
  EXPECT_NE(apply({0, 0, 0, 0}, 9, true).find("parts"), std::string::npos) << "a whole scene has a whole light";
  expect_refused("ends after", {});
  expect_refused("parts 32 of a light", {32, 0, 0, 0});
  expect_refused("more than 64 bits", {0, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0, 0});
  expect_refused("sun_irradiance is negative", {2, 0, 0, 0, 1, 0, 0, 0});
  expect_refused("sun_irradiance is out of bounds", {2, 0, 0, 0x80, 0x80, 4, 0, 0, 0, 0});
  expect_refused("too many", {0, 0, 0, 0, 0});
  // Objects: how many vanish, their ids, how many change, and for each its id and parts.
  expect_refused("3 objects vanish of 2", {0, 0, 3, 0, 0, 0, 0});
  expect_refused("object 5 vanishes", {0, 0, 1, 5, 0});
  expect_refused("at most 32769", {0, 0, 0, 0xFF, 0xFF, 0xFF, 0xFF, 0x0F});
  expect_refused("ends after", {0, 0, 0, 0x80, 0x10});
  expect_refused("above 32 bits", {0, 0, 0, 1, 0x80, 0x80, 0x80, 0x80, 0x10, 1});
  expect_refused("object 1: parts 0", {0, 0, 0, 1, 1, 0});
  expect_refused("object 1: parts 32", {0, 0, 0, 1, 1, 32});
  expect_refused("object 3: parts 3", {0, 0, 0, 1, 3, 3});
  expect_refused("object 1: its scale", {0, 0, 0, 1, 1, 8, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 1});
  expect_refused("object 1: its scale", {0, 0, 0, 1, 1, 8, 0x82, 0x80, 0x40});
  expect_refused("object 1: flags 4", {0, 0, 0, 1, 1, 16, 4});
  expect_refused("object 1 appears, but is already there", {0, 0, 0, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0});
  expect_refused("object 3 changes, but is not there", {0, 0, 0, 1, 3, 2, 0, 0, 0});
  expect_refused("object 1: its position",
                 {0, 0, 0, 1, 1, 2, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 1, 0, 0});
  expect_refused("object 1: its rotation", {0, 0, 0, 1, 1, 4, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0x1F});
  expect_refused("object 1: its rotation", {0, 0, 0, 1, 1, 4, 0, 0, 0, 0, 0, 0x80});
}

TEST_F(ForgedScene, AgainstAnyOtherThanTheHeldIsNotApplied) {
  for (const std::uint64_t from : {1U, 3U, 8U}) {
    ReplicatedState held = replica_.held();
    ASSERT_EQ(held.quantized_scene.version, 2U);
    const Bytes state = {0, 0, 0, 0};
    const auto packet = parse(writer_.write(
        77, 0, wire::Body::Scene, [&](auto& b) { return wire::CreateScene(b, 9, from, 1, b.CreateVector(state)); }));
    EXPECT_THROW(stream::apply(held, packet), SceneLost) << from;
    EXPECT_TRUE(held.quantized_scene == replica_.held().quantized_scene);
  }
}

TEST_F(ForgedScene, MoreObjectsThanAreTakenAreRefusedOverManyPackets) {
  for (std::uint32_t i = 0; i < kMaxObjects - 2; ++i) server_.scene.objects[10 + i];
  send(server_.change_scene(), replica_);
  ASSERT_EQ(replica_.scene().objects.size(), kMaxObjects);
  ReplicatedState held = replica_.held();
  const Bytes state = {0, 0, 0, 1, 3, 1, 0, 0, 0, 0, 0x40, 0, 0x20, 0, 0x10};
  const std::string why = refusal([&] {
    stream::apply(held, parse(writer_.write(77, 0, wire::Body::Scene, [&](auto& b) {
                    return wire::CreateScene(b, 9, held.scene.version, 1, b.CreateVector(state));
                  })));
  });
  EXPECT_NE(why.find("32770 objects"), std::string::npos) << why;
}

}  // namespace
}  // namespace splatbus::stream

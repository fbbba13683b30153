// Lights besides the sun on their way to viewers.
#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <string>

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

LightSource random_source(std::uint32_t id, std::mt19937& random) {
  std::normal_distribution<float> normal(0, 1);
  const auto vector = [&] { return glm::vec3(normal(random), normal(random), normal(random)); };
  LightSource source{.id = id,
                     .kind = static_cast<LightKind>(random() % 3),
                     .casts_shadow = random() % 2 == 0,
                     .position = 50.0F * vector(),
                     .direction = glm::normalize(vector()),
                     .intensity = std::exp(3 * normal(random)) * glm::abs(vector()),
                     .range_m = std::exp(2 * normal(random))};
  const float a = std::cos(normal(random)), b = std::cos(normal(random));
  source.cos_inner = std::max(a, b);
  source.cos_outer = std::min(a, b);
  return source;
}

TEST(SceneLights, AreTheSameAtAViewerThroughAllThatTheyDo) {
  ToyServer server(41);
  Replica replica;
  join(server.stream, replica);
  std::mt19937 random(7);
  std::normal_distribution<float> normal(0, 1);
  std::vector<LightSource>& sources = server.scene.light.sources;
  for (int frame = 0; frame < 600; ++frame) {
    for (LightSource& source : sources) {
      switch (random() % 12) {
        case 0:
          source = random_source(source.id, random);  // of another kind, mostly
          break;
        case 1:
          source.intensity *= 1.5F;
          break;
        case 2:
          source.direction = glm::normalize(source.direction + 0.1F * glm::vec3(normal(random), 0, 0));
          break;
        case 3:
          source.range_m *= 1.1F;
          break;
        case 4:
          source.cos_outer = -1;
          break;
        case 5:
          source.casts_shadow = !source.casts_shadow;
          break;
        default:
          source.position.x += 0.01F;
      }
    }
    if (!sources.empty() && random() % 4 == 0) sources.erase(sources.begin() + random() % sources.size());
    if (sources.size() < kMaxLightSources && random() % 3 == 0) {
      const std::uint32_t id = random() % 5 == 0 ? 0xFFFFFFFFU - random() % 3 : 1 + random() % 40;
      const auto at = std::ranges::lower_bound(sources, id, {}, &LightSource::id);
      if (at == sources.end() || at->id != id) sources.insert(at, random_source(id, random));
    }
    send(server.change_scene(), replica);
    expect_scene_near(replica.scene(), server.scene);
    if (frame % 100 == 0) {
      Replica late;
      join(server.stream, late);
      EXPECT_TRUE(late.held().quantized_scene == replica.held().quantized_scene);
    }
    if (HasFailure()) return;
  }
}

TEST(SceneLights, OnlyWhatChangesOfThemIsSent) {
  ToyServer server(42);
  std::mt19937 random(3);
  for (std::uint32_t id = 1; id <= kMaxLightSources; ++id) {
    server.scene.light.sources.push_back(random_source(id, random));
    server.scene.light.sources.back().kind = LightKind::Point;
  }
  const std::size_t all = server.change_scene().at(0).packet.size();
  server.scene.objects[1].rigid.translation.x = 1;
  const std::size_t none = server.change_scene().at(0).packet.size();
  for (std::size_t k = 0; k < 3; ++k) server.scene.light.sources[k].position += glm::vec3(0.05F);
  server.scene.objects[1].rigid.translation.x += 1;
  const std::size_t three = server.change_scene().at(0).packet.size();
  EXPECT_GT(all, 32U * 12);
  EXPECT_LE(three - none, 32U) << "three lights that move cost more than 10 bytes each";
}

std::string refusal(const std::function<void()>& action) {
  try {
    action();
  } catch (const StreamError& error) {
    return error.what();
  }
  return "nothing was refused";
}

/// Light 3 is directional, 5 a point light, 9 a spot.
SceneState lit() {
  SceneState scene;
  scene.version = 2;
  scene.light.sources = {{.id = 3, .kind = LightKind::Directional, .intensity = {1, 1, 1}},
                         {.id = 5, .kind = LightKind::Point, .intensity = {1, 1, 1}, .range_m = 4},
                         {.id = 9, .kind = LightKind::Spot, .intensity = {1, 1, 1}, .cos_inner = 0.9F}};
  return scene;
}

TEST(SceneLights, AStreamerRefusesByNameWhatIsNoLight) {
  const auto expect_refused = [](const std::string& word, auto&& spoil) {
    SceneState bad = lit();
    spoil(bad.light.sources);
    const std::string why = refusal([&] { (void)quantize_scene(bad); });
    EXPECT_NE(why.find(word), std::string::npos) << why;
  };
  const float nan = std::nanf("");
  expect_refused("light 5: position", [&](auto& s) { s[1].position.z = nan; });
  expect_refused("light 3: direction", [&](auto& s) { s[0].direction = {0, 0, 0}; });
  expect_refused("light 9: direction", [&](auto& s) { s[2].direction.x = nan; });
  expect_refused("light 5: intensity", [&](auto& s) { s[1].intensity.y = nan; });
  expect_refused("light 5: range_m", [&](auto& s) { s[1].range_m = 0; });
  expect_refused("light 9: range_m", [&](auto& s) { s[2].range_m = nan; });
  expect_refused("light 9: a cone", [&](auto& s) { s[2].cos_outer = 0.95F; });
  expect_refused("light 5: not in the order", [&](auto& s) { s[2].id = 5; });
  expect_refused("light 0: not in the order", [&](auto& s) { s[0].id = 0; });
  expect_refused("33 lights", [&](auto& s) {
    for (std::uint32_t id = 10; id < 40; ++id) s.push_back({.id = id});
  });
  // A cone that is narrower than what travels stays one.
  SceneState narrow = lit();
  narrow.light.sources[2].cos_inner = 1;
  narrow.light.sources[2].cos_outer = std::nextafter(1.0F, 0.0F);
  const LightSource spot = dequantize_scene(quantize_scene(narrow)).light.sources[2];
  EXPECT_LT(spot.cos_outer, spot.cos_inner);
}

TEST(SceneLights, AViewerRefusesByNameWhatIsNoLight) {
  const QuantizedScene held = quantize_scene(lit());
  // Lights: how many vanish, their ids, how many change, and for each its id and parts; then no objects.
  const auto apply = [&](Bytes lights) {
    lights.insert(lights.begin(), {16, 0});
    lights.insert(lights.end(), {0, 0});
    return refusal([&] { (void)decode_scene(lights, &held, 9); });
  };
  const auto expect_refused = [&](const std::string& word, const Bytes& lights) {
    const std::string why = apply(lights);
    EXPECT_TRUE(why.starts_with("Scene: ") && why.find(word) != std::string::npos) << why;
  };
  EXPECT_EQ(apply({0, 0}), "nothing was refused");
  EXPECT_EQ(apply({3, 3, 1, 3, 0}), "nothing was refused");
  EXPECT_EQ(apply({0, 1, 5, 2, 2, 2, 2}), "nothing was refused");
  expect_refused("4 lights vanish of 3", {4, 3, 1, 3, 0, 0});
  expect_refused("light 4 vanishes", {1, 4, 0});
  expect_refused("33 lights, at most 32", {0, 33});
  expect_refused("light 0 is the sun", {0, 1, 0, 1, 1});
  expect_refused("light 5 appears, but is already there", {0, 1, 5, 1, 1});
  expect_refused("light 4 changes, but is not there", {0, 1, 4, 2, 2, 2, 2});
  expect_refused("light 5: parts 0", {0, 1, 5, 0});
  expect_refused("light 5: parts 4", {0, 1, 5, 4, 0, 0, 0, 0});  // a point light has no direction,
  expect_refused("light 3: parts 2", {0, 1, 3, 2, 0, 0, 0});     // a directional one no position
  expect_refused("light 3: parts 16", {0, 1, 3, 16, 1, 0});      // and no range
  expect_refused("light 9: parts 32", {0, 1, 9, 32});
  expect_refused("light 4: parts 3", {0, 1, 4, 3, 1});
  expect_refused("light 4: kind 3", {0, 1, 4, 1, 3});
  expect_refused("light 4: kind 8", {0, 1, 4, 1, 8});
  expect_refused("light 5: its position", {0, 1, 5, 2, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 1, 0, 0});
  expect_refused("light 5: its intensity is negative", {0, 1, 5, 8, 1, 0xFF, 0x3F, 0, 0});
  expect_refused("light 5: its intensity is out of bounds", {0, 1, 5, 8, 1, 0x80, 0x80, 4, 0, 0});
  expect_refused("light 5: its range is not above 0", {0, 1, 5, 16, 3, 0xFF, 0x3F});
  expect_refused("light 9: its cone is not valid", {0, 1, 9, 16, 4, 0, 0, 0x80, 0x80, 0x7E});
  expect_refused("light 9: its cone is out of bounds", {0, 1, 9, 16, 4, 0, 0x80, 0x80, 0x80, 0x80, 1, 0});
  expect_refused("ends after", {0, 1, 5, 2, 0x80});
  expect_refused("above 32 bits", {0, 1, 0x80, 0x80, 0x80, 0x80, 0x10, 1});
}

TEST(SceneLights, MoreThanAreTakenAreRefusedOverManyPackets) {
  SceneState scene = lit();
  for (std::uint32_t id = 10; scene.light.sources.size() < kMaxLightSources; ++id) {
    scene.light.sources.push_back({.id = id, .intensity = {1, 1, 1}});
  }
  const QuantizedScene held = quantize_scene(scene);
  const Bytes one_more = {16, 0, 0, 1, 100, 1, 0, 0, 0, 0, 0, 0, 2, 2, 2, 0, 0};
  const std::string why = refusal([&] { (void)decode_scene(one_more, &held, 9); });
  EXPECT_NE(why.find("33 lights, at most 32"), std::string::npos) << why;
}

}  // namespace
}  // namespace splatbus::stream

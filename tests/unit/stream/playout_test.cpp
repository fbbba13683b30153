#include "stream/playout.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <random>
#include <vector>

#include "../nanoseconds.h"

namespace splatbus::stream {
namespace {

constexpr std::int64_t kEngineClock = 7'000 * kSecond;  // ahead of the viewer's
constexpr std::uint32_t kBall = 5;

/// Of a ball that goes round once in 4 s, a metre from the middle, turning as it goes.
Rigid truth_at(double engine_s) {
  const double turn = engine_s * std::numbers::pi / 2;
  return {glm::angleAxis(static_cast<float>(turn), glm::vec3(0, 1, 0)),
          {static_cast<float>(std::cos(turn)), 0.5F, static_cast<float>(std::sin(turn))}};
}

std::shared_ptr<const SceneState> scene_at(std::int64_t capture_ns) {
  SceneState scene;
  const double seconds = static_cast<double>(capture_ns - kEngineClock) / 1e9;
  scene.objects[kBall] = ObjectTransform(truth_at(seconds));
  scene.light.sun_direction = glm::normalize(glm::vec3(std::cos(seconds), 1, std::sin(seconds)));
  scene.light.background = glm::vec3(static_cast<float>(seconds));
  return std::make_shared<const SceneState>(std::move(scene));
}

struct Seen {
  double worst_px = 0, worst_turn_radians = 0, worst_light = 0;
  std::int64_t most_delay_ns = 0, least_step_ns = kSecond;  ///< the step: after 1 s
  std::size_t frames = 0, beyond = 0;                       ///< after 2 s: of what had not come yet
};

/// 10 s of a viewer at 60 frames/s of an engine at 30, whose states take 5 ms and up to `jitter_ns` more.
Seen play(std::int64_t jitter_ns, std::uint32_t seed) {
  std::mt19937 random(seed);
  std::uniform_int_distribution<std::int64_t> late(0, jitter_ns);
  const Camera camera = look_at({0, 2, 4}, {0, 0.5F, 0}, 1280, 720, 1.0F);
  Playout playout;
  Seen seen;
  std::int64_t sent = 0, arrives = 5 * kMs + late(random), shown_before = 0;
  for (std::int64_t frame = 0; frame < 600; ++frame) {
    const std::int64_t now = frame * kSecond / 60;
    while (arrives <= now) {
      const std::int64_t capture = kEngineClock + sent * kSecond / 30;
      playout.add(scene_at(capture), capture, arrives);
      ++sent;  // in order, as they come through one connection
      arrives = std::max(arrives, sent * kSecond / 30 + 5 * kMs + late(random));
    }
    playout.advance(now);
    const auto scene = playout.scene();
    if (!scene || playout.shown_ns() < kEngineClock) continue;  // of before the first state
    const double seconds = static_cast<double>(playout.shown_ns() - kEngineClock) / 1e9;
    const Rigid& ball = scene->objects.at(kBall).rigid;
    const Rigid truth = truth_at(seconds);
    const glm::vec2 where = project(camera, ball.translation), meant = project(camera, truth.translation);
    seen.worst_px = std::max<double>(seen.worst_px, glm::distance(where, meant));
    const double turned = std::abs(glm::dot(ball.rotation, truth.rotation));
    seen.worst_turn_radians = std::max(seen.worst_turn_radians, 2 * std::acos(std::min(turned, 1.0)));
    seen.worst_light = std::max<double>(seen.worst_light, std::abs(scene->light.background.x - seconds));
    seen.most_delay_ns = std::max(seen.most_delay_ns, now + kEngineClock - playout.shown_ns());
    if (now > kSecond) seen.least_step_ns = std::min(seen.least_step_ns, playout.shown_ns() - shown_before);
    const std::int64_t newest = kEngineClock + (sent - 1) * kSecond / 30;
    if (now > 2 * kSecond && playout.shown_ns() > newest) ++seen.beyond;
    shown_before = playout.shown_ns();
    ++seen.frames;
  }
  return seen;
}

TEST(Playout, ABallOnACircleIsWhereTheEngineHadIt) {
  const Seen seen = play(0, 1);
  EXPECT_GT(seen.frames, 590U);
  EXPECT_LT(seen.worst_px, 1);
  EXPECT_LT(seen.worst_turn_radians, 0.01);
  EXPECT_EQ(seen.beyond, 0U);
  EXPECT_GE(seen.least_step_ns, 8 * kMs) << "it runs on, at half its speed at least";
  EXPECT_LT(seen.most_delay_ns, 60 * kMs);
}

TEST(Playout, AndWith20MsOfJitter) {
  for (std::uint32_t seed = 1; seed <= 20; ++seed) {
    const Seen seen = play(20 * kMs, seed);
    EXPECT_GT(seen.frames, 590U);
    EXPECT_LT(seen.worst_px, 1) << seed;
    EXPECT_LT(seen.worst_light, 0.04) << seed;  // it does not run ahead of what has come
    EXPECT_LT(seen.beyond, 30U) << seed;
    EXPECT_GE(seen.least_step_ns, 8 * kMs) << seed;
    EXPECT_LT(seen.most_delay_ns, 100 * kMs) << seed;
  }
}

TEST(Playout, ALightIsOnItsWayBetweenTheTwoStatesThatSayIt) {
  const glm::vec3 from_colour(0.5F, 1, 4), to_colour(2.5F, 1, 0), quarter(1, 1, 3);
  const auto lit = [](const glm::vec3& colour, float turned) {
    SceneState scene;
    scene.light.sun_direction = {std::cos(turned), std::sin(turned), 0};
    scene.light.sun_irradiance = scene.light.background = colour;
    for (std::size_t k = 0; k < scene.light.ambient_sh.size(); ++k) {
      scene.light.ambient_sh[k] = colour * static_cast<float>(k + 1);
    }
    scene.light.sources.push_back(
        {.id = 3, .kind = LightKind::Spot, .position = colour, .direction = {0, -1, 0}, .intensity = 2.0F * colour});
    return scene;
  };
  const Light light = scene_between(lit(from_colour, 0), lit(to_colour, 0.2F), 0.25).light;
  EXPECT_EQ(light.background, quarter);
  EXPECT_EQ(light.sun_irradiance, quarter);
  for (std::size_t k = 0; k < light.ambient_sh.size(); ++k) {
    EXPECT_EQ(light.ambient_sh[k], quarter * static_cast<float>(k + 1));
  }
  ASSERT_EQ(light.sources.size(), 1U);
  EXPECT_EQ(light.sources[0].position, quarter);
  EXPECT_EQ(light.sources[0].intensity, 2.0F * quarter);
  EXPECT_NEAR(std::atan2(light.sun_direction.y, light.sun_direction.x), 0.05, 1e-3);
  EXPECT_NEAR(glm::length(light.sun_direction), 1, 1e-6);
}

TEST(Playout, WhatIsBetweenTwoStatesIsOfTheNearersVersion) {
  const SceneState from{.light = {}, .objects = {}, .version = 7}, to{.light = {}, .objects = {}, .version = 9};
  EXPECT_EQ(scene_between(from, to, 0.4).version, 7U);
  EXPECT_EQ(scene_between(from, to, 0.6).version, 9U);
  EXPECT_EQ(scene_between(from, to, 1.3).version, 9U);
}

TEST(Playout, RunsSlowerWhileTheDelayGrowsAndNeverBack) {
  Playout playout;
  std::int64_t sent = 0, before = 0;
  for (std::int64_t now = 0; now < 4 * kSecond; now += kMs) {
    const std::int64_t late = now < 2 * kSecond ? 0 : 40 * kMs;  // the link has become slower
    for (; sent * kSecond / 30 + late <= now; ++sent) {
      const std::int64_t capture = kEngineClock + sent * kSecond / 30;
      playout.add(scene_at(capture), capture, now);
    }
    playout.advance(now);
    const std::int64_t step = playout.shown_ns() - before;
    before = playout.shown_ns();
    if (now < kSecond) continue;
    EXPECT_GE(step, kMs / 2) << now;
    EXPECT_LE(step, kMs + kMs / 50) << now;
  }
  EXPECT_GT(playout.delay_ns(), 70 * kMs);
}

TEST(Playout, GoesOnFor100MsAndRests) {
  Playout playout;
  for (std::int64_t k = 0; k < 10; ++k) {
    const std::int64_t capture = kEngineClock + k * kSecond / 30;
    playout.add(scene_at(capture), capture, k * kSecond / 30);
    playout.advance(k * kSecond / 30);
  }
  const std::int64_t last = kEngineClock + 9 * kSecond / 30;
  std::int64_t now = 9 * kSecond / 30;
  const auto run_for = [&](std::int64_t ns) {
    for (const std::int64_t end = now + ns; now < end;) playout.advance(now += kMs);
    return playout.scene()->objects.at(kBall).rigid.translation;
  };
  const glm::vec3 newest = scene_at(last)->objects.at(kBall).rigid.translation;
  EXPECT_GT(glm::distance(run_for(90 * kMs), newest), 0.05F);
  EXPECT_TRUE(playout.moving());
  EXPECT_EQ(playout.scene()->light, scene_at(last)->light) << "which nobody saw";
  EXPECT_LT(playout.shown_ns(), last + 100 * kMs);
  const glm::vec3 rests = run_for(100 * kMs);
  EXPECT_EQ(playout.shown_ns(), last + 100 * kMs);
  EXPECT_FALSE(playout.moving());
  EXPECT_EQ(run_for(200 * kMs), rests);
  EXPECT_NEAR(glm::distance(rests, newest), 0.1 * std::numbers::pi / 2, 0.02);
}

TEST(Playout, TakesWhatAppearsAtOnceAndBeginsAnewWithAnotherClock) {
  Playout playout;
  EXPECT_EQ(playout.scene(), nullptr);
  const auto untimed = scene_at(kEngineClock);
  playout.add(untimed, 0, 0);
  EXPECT_EQ(playout.scene(), untimed);
  playout.add(scene_at(kEngineClock), kEngineClock, 0);
  SceneState more = *scene_at(kEngineClock + 33 * kMs);
  more.objects[9] = ObjectTransform(Rigid{.translation = {3, 0, 0}});
  playout.add(std::make_shared<const SceneState>(more), kEngineClock + 33 * kMs, 33 * kMs);
  playout.advance(10 * kMs);
  playout.advance(50 * kMs);
  ASSERT_TRUE(playout.scene()->objects.contains(9));
  const auto restarted = scene_at(kEngineClock);
  playout.add(restarted, 5, 100 * kMs);
  playout.advance(100 * kMs);
  EXPECT_EQ(playout.scene(), restarted);
}

}  // namespace
}  // namespace splatbus::stream

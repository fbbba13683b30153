#include "sim/living_toys.h"

#include <array>
#include <cmath>
#include <glm/gtc/constants.hpp>
#include <utility>

#include "sim/figure.h"
#include "sim/patterns.h"

namespace splatbus::sim {
namespace {

/// A rotation by radians that grow without end, without loss of precision.
glm::quat turned(double radians, const glm::vec3& axis) {
  return glm::angleAxis(static_cast<float>(std::remainder(radians, 2 * glm::pi<double>())), axis);
}

/// An object that stands still, and exists when `exists` of a time says so.
template <class Exists>
void add_visitor(Scene& scene, const char* name, Mesh mesh, Image image, const Pose& pose, Exists exists) {
  Object& visitor = scene.add(name, std::move(mesh), std::move(image));
  visitor.motion_origins.add(pose.translation);
  visitor.motion = [=](double time_s) { return exists(time_s) ? std::optional(pose) : std::nullopt; };
}

Mesh skittle() {
  return lathe(std::array<glm::vec2, 9>{{{0, 0},
                                         {0.09F, 0},
                                         {0.14F, 0.12F},
                                         {0.13F, 0.2F},
                                         {0.07F, 0.31F},
                                         {0.06F, 0.37F},
                                         {0.085F, 0.43F},
                                         {0.06F, 0.49F},
                                         {0, 0.51F}}},
               32, 2);
}

Mesh pot_mesh() {
  return lathe(
      std::array<glm::vec2, 6>{{{0, 0}, {0.09F, 0}, {0.125F, 0.1F}, {0.11F, 0.22F}, {0.125F, 0.26F}, {0, 0.25F}}}, 32,
      2);
}

}  // namespace

void add_ball(Scene& scene, const glm::vec3& foot) {
  constexpr float kRadius = 0.16F, kCircle_m = 0.10F;
  constexpr double kHeight_m = 0.7;
  const glm::vec3 middle = foot + glm::vec3(0, kRadius, 0);
  Object& ball = scene.add("bouncing ball", sphere(kRadius, 32, 2), checker(6, color("#e8e2d4"), color("#c2267a")));
  ball.motion_origins.add(middle - glm::vec3(kCircle_m, 0, kCircle_m));
  ball.motion_origins.add(middle + glm::vec3(kCircle_m, kHeight_m, kCircle_m));
  ball.motion = [=](double time_s) {
    // A parabola a bounce, under 9.8 m/s^2 from kHeight_m, while it wanders on a small circle and spins.
    const double bounce_s = 2 * std::sqrt(2 * kHeight_m / 9.8);
    const double phase = time_s / bounce_s - std::floor(time_s / bounce_s);
    const double angle = 0.6 * time_s;
    Pose pose;
    pose.translation = middle + glm::vec3(kCircle_m * std::cos(angle), 4 * kHeight_m * phase * (1 - phase),
                                          kCircle_m * std::sin(angle));
    pose.rotation = turned(1.7 * time_s, glm::normalize(glm::vec3{0.3F, 1, 0.2F}));
    return pose;
  };
}

void add_cube(Scene& scene, const glm::vec3& middle) {
  Object& cube =
      scene.add("turning cube", box({0.26F, 0.26F, 0.26F}), letter("GO", color("#3fa7a0"), color("#f0e6c8")));
  cube.motion_origins.add(middle);
  cube.motion = [=](double time_s) { return Pose{turned(0.8 * time_s, kUp), middle}; };
}

void add_living_toys(Scene& scene) {
  using Times = LivingTimes;
  add_ball(scene, {0.05F, 0, 0.31F});
  add_cube(scene, {-0.72F, 0.13F, 0.22F});
  add_figure(scene);
  add_visitor(scene, "skittle", skittle(), dots(6, color("#2d8fb0"), color("#f2e3b3"), 0.3F),
              {turned(0.4, kUp), {-1.0F, 0, -1.3F}}, [](double time_s) { return time_s < Times::kVanish_s; });
  add_visitor(scene, "appearing crate", box({0.32F, 0.32F, 0.32F}), letter("NEW", color("#c8452f"), color("#f3ead2")),
              {turned(0.5, kUp), {1.45F, 0.16F, -0.45F}}, [](double time_s) { return time_s >= Times::kAppear_s; });
  add_visitor(scene, "drum", cylinder(0.16F, 0.3F, 32, 2),
              stripes(std::array{color("#6a3fa0"), color("#ecd9a2"), color("#3f9a6b")}, 2, true),
              {turned(0, kUp), {-0.62F, 0, 1.52F}}, [](double time_s) {
                const double in_round_s = time_s - Times::kRound_s * std::floor(time_s / Times::kRound_s);
                return in_round_s < Times::kLeave_s || in_round_s >= Times::kReturn_s;
              });
  add_figure_camera(scene);
}

void add_breathing_toy(Scene& scene) {
  constexpr double kBreath_s = 5;
  constexpr glm::vec3 kPlace{0.68F, 0, -1.07F};
  Object& pot = scene.add("breathing pot", pot_mesh(),
                          stripes(std::array{color("#d9a13b"), color("#3b5f8a"), color("#e9e1cc")}, 2, false));
  pot.motion_origins.add(kPlace);
  pot.greatest_scale = kGreatestBreath;
  pot.motion = [=](double time_s) {
    // As long above 1 as below: kLeastBreath is 1 / kGreatestBreath.
    const double phase = 2 * glm::pi<double>() * std::remainder(time_s / kBreath_s, 1.0);
    return Pose{.translation = kPlace, .scale = static_cast<float>(std::pow(kGreatestBreath, std::sin(phase)))};
  };
}

}  // namespace splatbus::sim

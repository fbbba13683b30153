#pragma once

#include "sim/scene.h"

namespace splatbus::sim {

/// When the toys that come and go do so, in seconds of engine time. An instant belongs to what it begins.
struct LivingTimes {
  static constexpr double kVanish_s = 20;  ///< the skittle is there before
  static constexpr double kAppear_s = 40;  ///< the crate is there from then on
  /// The drum is away from kLeave_s to kReturn_s of each kRound_s.
  static constexpr double kLeave_s = 10, kReturn_s = 15, kRound_s = 30;
};

/// Adds what moves, comes or goes among the toys: "bouncing ball", "turning cube", the walking figure (figure.h),
/// "skittle", "appearing crate" and "drum". All cast shadows, and none passes through another toy.
void add_living_toys(Scene& scene);

/// Two of them: a ball of 0.16 m that bounces on `foot`, and a cube of 0.26 m that turns about `middle`.
void add_ball(Scene& scene, const glm::vec3& foot);
void add_cube(Scene& scene, const glm::vec3& middle);

/// Adds the "breathing pot", which stands among the toys and grows and shrinks about where it stands.
void add_breathing_toy(Scene& scene);
inline constexpr float kLeastBreath = 0.8F, kGreatestBreath = 1.25F;  ///< its scale

}  // namespace splatbus::sim

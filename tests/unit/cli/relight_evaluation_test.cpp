#include "relight_evaluation.h"

#include <gtest/gtest.h>

#include "sim/scene.h"

namespace splatbus::cli {
namespace {

glm::vec3 sun_at(double azimuth_deg) {
  sim::Lighting lighting;
  lighting.sun_azimuth_deg = azimuth_deg;
  const splatbus_light light = lighting.at(0);
  return {light.sun_direction[0], light.sun_direction[1], light.sun_direction[2]};
}

TEST(RelightEvaluation, TurnsAsTheEngineDoes) {
  const glm::vec3 first = sun_at(40);
  EXPECT_NEAR(azimuth_deg(first), 40, 1e-4);
  EXPECT_NEAR(azimuth_deg(sun_at(-130)), -130, 1e-4);
  for (const double turn_deg : {60.0, 90.0, 120.0, 150.0, 180.0}) {
    EXPECT_LT(glm::distance(turned(first, turn_deg), sun_at(40 + turn_deg)), 1e-5F) << turn_deg;
  }
}

}  // namespace
}  // namespace splatbus::cli

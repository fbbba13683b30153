#include "gaussians/sh.h"

#include <gtest/gtest.h>

#include "gaussians/light.h"
#include "random.h"

namespace splatbus {
namespace {

TEST(Sh16, FirstBandsHaveTheSignsOf3dgs) {
  const Sh16 x = sh16_basis({1, 0, 0}), y = sh16_basis({0, 1, 0}), z = sh16_basis({0, 0, 1});
  EXPECT_FLOAT_EQ(x[0], kShC0);
  EXPECT_FLOAT_EQ(y[1], -kShC1);
  EXPECT_FLOAT_EQ(z[2], kShC1);
  EXPECT_FLOAT_EQ(x[3], -kShC1);
  EXPECT_FLOAT_EQ(z[6], 2 * kShC2[2]);
  EXPECT_FLOAT_EQ(x[8], kShC2[4]);
  EXPECT_FLOAT_EQ(x[15], kShC3[6]);
}

TEST(Sh16, IsOrthonormal) {
  // Rotation by nothing is the table of inner products, by a quadrature that is exact.
  const ShRotation products = sh_rotation(glm::quat(1, 0, 0, 0));
  for (std::size_t j = 0; j < 16; ++j) {
    for (std::size_t k = 0; k < 16; ++k) EXPECT_NEAR(products[j][k], j == k ? 1.0F : 0.0F, 2e-6F) << j << " " << k;
  }
}

TEST(ShRotation, EqualsEvaluatingTheRotatedDirection) {
  test::Random random(7);
  for (int i = 0; i < 100; ++i) {
    const glm::quat rotation = random.rotation();
    const ShRotation matrix = sh_rotation(rotation);
    Sh16 coefficients{};
    for (float& c : coefficients) c = random.uniform(-1, 1);
    const glm::vec3 d = random.direction();
    const Sh16 here = sh16_basis(d), there = sh16_basis(glm::conjugate(rotation) * d);
    float rotated = 0, expected = 0;
    for (std::size_t j = 0; j < 16; ++j) {
      expected += coefficients[j] * there[j];
      for (std::size_t k = 0; k < 16; ++k) rotated += here[j] * matrix[j][k] * coefficients[k];
    }
    EXPECT_NEAR(rotated, expected, 1e-5F);
  }
}

TEST(ShRotation, AgreesWithTheClosedFormOfDegreeTwo) {
  test::Random random(8);
  const glm::quat rotation = random.rotation();
  const ShRotation matrix = sh_rotation(rotation);
  const Light light = random.light();
  const auto closed = rotate_sh9(light.ambient_sh, rotation);
  for (std::size_t j = 0; j < 9; ++j) {
    glm::vec3 sum(0);
    for (std::size_t k = 0; k < 9; ++k) sum += matrix[j][k] * light.ambient_sh[k];
    EXPECT_LE(glm::distance(sum, closed[j]), 2e-6F);
  }
}

}  // namespace
}  // namespace splatbus

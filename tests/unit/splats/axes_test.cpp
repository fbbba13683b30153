#include "splats/axes.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <glm/gtc/constants.hpp>

#include "../gaussians/random.h"

namespace splatbus::splats {
namespace {

/// Real SH with the Condon-Shortley phase in float64, from Legendre's functions instead of polynomials in x, y, z.
double basis(int l, int m, const glm::dvec3& d) {
  const double cosine = d.z, sine = std::hypot(d.x, d.y), phi = std::atan2(d.y, d.x);
  const int order = std::abs(m);
  double diagonal = 1;  // P_order^order, phase included
  for (int k = 1; k <= order; ++k) diagonal *= -(2 * k - 1) * sine;
  double below = 0, legendre = diagonal;
  for (int k = order + 1; k <= l; ++k) {
    const double next = ((2 * k - 1) * cosine * legendre - (k + order - 1) * below) / (k - order);
    below = legendre;
    legendre = next;
  }
  const double norm =
      std::sqrt((2 * l + 1) / (4 * glm::pi<double>()) * std::tgamma(l - order + 1) / std::tgamma(l + order + 1));
  if (m == 0) return norm * legendre;
  return std::sqrt(2.0) * norm * legendre * (m > 0 ? std::cos(order * phi) : std::sin(order * phi));
}

double shown(const Splat& splat, int color, const glm::dvec3& direction) {
  double sum = 0.5;
  for (int l = 0; l <= 3; ++l) {
    for (int m = -l; m <= l; ++m) {
      sum += basis(l, m, direction) * double{splat.sh[static_cast<std::size_t>(l * (l + 1) + m)][color]};
    }
  }
  return sum;
}

/// R S S^T R^T in float64.
glm::dmat3 covariance(const Splat& splat) {
  const glm::dmat3 rotation(glm::mat3_cast(glm::normalize(glm::dquat(splat.rotation))));
  glm::dmat3 scale(0);
  for (int axis = 0; axis < 3; ++axis) scale[axis][axis] = std::exp(2 * double{splat.log_scale[axis]});
  return rotation * scale * glm::transpose(rotation);
}

Splat random_splat(test::Random& random) {
  Splat splat;
  splat.mean = random.vector(-5, 5);
  splat.normal = random.direction();
  splat.log_scale = random.vector(-3, 0);
  splat.rotation = random.rotation();
  splat.opacity_logit = random.uniform(-3, 3);
  for (glm::vec3& coefficient : splat.sh) coefficient = random.vector(-1, 1);
  return splat;
}

TEST(Axes, TheBasisIsTheRasterisers) {
  test::Random random(40);
  for (int i = 0; i < 20; ++i) {
    const glm::vec3 d = random.direction();
    const Sh16 ours = sh16_basis(d);
    for (int l = 0; l <= 3; ++l) {
      for (int m = -l; m <= l; ++m) {
        EXPECT_NEAR(ours[static_cast<std::size_t>(l * (l + 1) + m)], basis(l, m, d), 1e-5) << l << " " << m;
      }
    }
  }
}

TEST(Axes, ATurnedGaussianIsTheSameSeenFromTheTurnedSide) {
  test::Random random(41);
  glm::dmat3 turn(0);  // by half a turn about z, written as a matrix
  turn[0][0] = turn[1][1] = -1;
  turn[2][2] = 1;
  for (int i = 0; i < 50; ++i) {
    const Splat before = random_splat(random), after = turned(before);
    EXPECT_EQ(after.mean, glm::vec3(turn * glm::dvec3(before.mean)));
    EXPECT_EQ(after.normal, glm::vec3(turn * glm::dvec3(before.normal)));
    EXPECT_EQ(after.log_scale, before.log_scale);
    EXPECT_EQ(after.opacity_logit, before.opacity_logit);
    const glm::dmat3 expected = turn * covariance(before) * glm::transpose(turn), actual = covariance(after);
    for (int column = 0; column < 3; ++column) {
      EXPECT_LE(glm::distance(actual[column], expected[column]), 1e-12);
    }
    const glm::dvec3 d(random.direction());
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(shown(after, c, turn * d), shown(before, c, d), 1e-6);
  }
}

TEST(Axes, TwiceIsExactlyTheSame) {
  test::Random random(42);
  const Splat before = random_splat(random), after = turned(turned(before));
  EXPECT_EQ(after.mean, before.mean);
  EXPECT_EQ(after.rotation, -before.rotation);
  EXPECT_EQ(after.sh, before.sh);
}

TEST(Axes, AWholeModelIsTurnedGaussianByGaussian) {
  test::Random random(43);
  const GaussiansBuffer before = random.gaussians({Appearance::Radiance, 2}, 9);
  GaussiansBuffer after = before;
  turn(after);
  for (std::size_t i = 0; i < before.count(); ++i) {
    const Splat expected = turned(load(before.view(), i)), actual = load(after.view(), i);
    EXPECT_EQ(actual.mean, expected.mean);
    EXPECT_EQ(actual.sh, expected.sh);
    EXPECT_NEAR(std::abs(glm::dot(actual.rotation, expected.rotation)), 1, 1e-6F);
  }
}

}  // namespace
}  // namespace splatbus::splats

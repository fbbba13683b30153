#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <map>
#include <random>
#include <set>

#include "sampled_views.h"

namespace splatbus::capture_bridge::test {
namespace {

std::vector<float> spacing_of(const std::vector<glm::vec3>& position, const std::vector<glm::vec3>& normal,
                              std::vector<float> fallback_m) {
  estimate_spacing({}, position.empty() ? nullptr : &position[0].x, normal.empty() ? nullptr : &normal[0].x,
                   static_cast<std::uint32_t>(position.size()), fallback_m.data());
  return fallback_m;
}

std::vector<std::uint32_t> thinned(const std::vector<glm::vec3>& position, const std::vector<float>& area_m2,
                                   std::size_t budget) {
  device::Buffer<std::uint32_t> kept{device::StreamView()};
  const std::uint32_t count =
      thin_to_budget({}, &position[0].x, area_m2.data(), static_cast<std::uint32_t>(position.size()), budget, kept);
  return {kept.data(), kept.data() + count};
}

TEST(Sampling, NothingThatIsNotFiniteGetsThrough) {
  const AnalyticScene scene;
  auto views = scene.render_all(small_dome(4, 48));
  for (auto& position : views[1].position) position = glm::vec4(std::numeric_limits<float>::quiet_NaN());
  std::ranges::fill(views[1].object_id, 1U);
  for (auto& normal : views[2].normal) normal = glm::vec4(std::numeric_limits<float>::quiet_NaN());
  const SampledRound round = sample(views, {}, unlimited());
  ASSERT_GT(round.samples.size(), 500U);
  EXPECT_EQ(round.dropped[1].not_finite, views[1].pixels());
  for (std::size_t i = 0; i < round.samples.size(); ++i) {
    ASSERT_NE(round.samples.camera[i], 1U);
    ASSERT_NE(round.samples.camera[i], 2U);
    ASSERT_TRUE(std::isfinite(glm::dot(round.samples.position[i], round.samples.normal[i])));
    ASSERT_GT(round.samples.spacing_m[i], 0);
  }
}

TEST(Spacing, OfASquareGridIsItsStep) {
  std::vector<glm::vec3> position;
  std::vector<glm::vec3> normal;
  std::vector<bool> inside;
  for (int x = 0; x < 30; ++x) {
    for (int y = 0; y < 30; ++y) {
      for (const float side : {1.0F, -1.0F}) {  // the other side of a thin sheet is no neighbour
        position.emplace_back(0.02F * static_cast<float>(x), 0.001F * side, 0.02F * static_cast<float>(y));
        normal.emplace_back(0, side, 0);
        inside.push_back(x > 0 && x < 29 && y > 0 && y < 29);
      }
    }
  }
  const auto spacing = spacing_of(position, normal, std::vector<float>(position.size(), 0.03F));
  for (std::size_t i = 0; i < spacing.size(); ++i) {
    // At a border the fourth neighbour is a diagonal one, at a corner the third and the fourth are farther still.
    ASSERT_NEAR(spacing[i], 0.02F, inside[i] ? 1e-5F : 0.36F * 0.02F);
  }
}

TEST(Spacing, OfALoneSampleIsItsFallback) {
  const std::vector<glm::vec3> position{{0, 0, 0}, {5, 0, 0}};
  const std::vector<glm::vec3> normal(2, {0, 1, 0});
  EXPECT_EQ(spacing_of(position, normal, std::vector<float>{0.1F, 0.2F}), (std::vector<float>{0.1F, 0.2F}));
  EXPECT_TRUE(spacing_of({}, {}, {}).empty());
}

TEST(Spacing, MatchesTheDensityAfterCullingAndBudget) {
  const auto views = AnalyticScene{}.render_all(small_dome());
  for (const std::size_t budget : {std::size_t{1'000'000}, std::size_t{4000}}) {
    const SampledRound round = sample(views, {}, {.budget = budget, .cameras_per_surface = 1});
    // Truth: the area of a patch of the floor over the samples in it, away from the ball and the sheet.
    double truth_samples = 0;
    double mean_spacing = 0;
    for (std::size_t i = 0; i < round.samples.size(); ++i) {
      const glm::vec3& p = round.samples.position[i];
      if (round.samples.object_id[i] != AnalyticScene::kFloor || p.x < -0.5F || p.x > 0.5F || p.z < 0.8F || p.z > 1.8F)
        continue;
      ++truth_samples;
      mean_spacing += round.samples.spacing_m[i];
    }
    ASSERT_GT(truth_samples, 50);
    mean_spacing /= truth_samples;
    const double truth = std::sqrt(1.0 / truth_samples);
    EXPECT_NEAR(mean_spacing, truth, 0.15 * truth) << "budget " << budget;
  }
}

TEST(Spacing, OfTheOneSampleThatABudgetLeavesIsTheSideOfItsSquare) {
  const AnalyticScene scene{.ball_centre = {9, 9, 9}, .sheet_centre = {9, 9, 9}};
  const auto views = scene.render_all({look_at({0, 2, 0.001F}, {0, 0, 0}, 32, 32, 0.5F)});
  SamplingOptions options = unlimited();
  options.budget = 1;
  const SampledRound round = sample(views, {}, options);
  ASSERT_EQ(round.samples.size(), 1U);
  ASSERT_EQ(round.valid, 32U * 32U);
  // It stands for all that the picture shows.
  EXPECT_NEAR(round.samples.spacing_m[0], 2 * 2 * std::tan(0.25F), 0.02F);
}

TEST(Budget, KeepsExactlyTheBudgetEvenly) {
  const auto views = AnalyticScene{}.render_all(small_dome());
  const SampledRound round = sample(views, {}, {.budget = 3000});
  EXPECT_LE(round.samples.size(), 3000U);
  EXPECT_GE(round.samples.size(), 2990U);
  // Even: among squares of the open floor the counts vary far less than a random choice's (a variance of the mean).
  std::map<std::pair<int, int>, int> counts;
  for (std::size_t i = 0; i < round.samples.size(); ++i) {
    const glm::vec3& p = round.samples.position[i];
    if (round.samples.object_id[i] == AnalyticScene::kFloor && p.z > 0.75F && std::abs(p.x) < 2 && p.z < 2.25F) {
      ++counts[{static_cast<int>(std::floor(p.x * 4)), static_cast<int>(std::floor(p.z * 4))}];
    }
  }
  double mean = 0;
  double variance = 0;
  for (const auto& [square, count] : counts) mean += count;
  mean /= 16 * 6;
  for (const auto& [square, count] : counts) variance += (count - mean) * (count - mean);
  variance /= 16 * 6;
  EXPECT_EQ(counts.size(), 16U * 6U);
  EXPECT_LT(variance, 0.6 * mean) << "mean " << mean;
}

TEST(Budget, ThinsDenseSurfacesFirst) {
  std::vector<glm::vec3> position;
  std::vector<float> area;
  for (int i = 0; i < 1000; ++i) {
    position.emplace_back(0.001F * static_cast<float>(i), 0, 0);
    area.push_back(1e-6F);
  }
  for (int i = 0; i < 10; ++i) {
    position.emplace_back(10 + static_cast<float>(i), 0, 0);
    area.push_back(1);
  }
  const auto kept = thinned(position, area, 100);
  EXPECT_EQ(kept.size(), 100U);
  EXPECT_EQ(std::count_if(kept.begin(), kept.end(), [](auto i) { return i >= 1000; }), 10);
  EXPECT_EQ(std::set<std::uint32_t>(kept.begin(), kept.end()).size(), kept.size());
  EXPECT_EQ(thinned(position, area, 100), kept);
  EXPECT_EQ(thinned(position, area, 5000).size(), position.size());
  EXPECT_TRUE(thinned(position, area, 0).empty());
}

TEST(Budget, KeepsAsManyAsItSaysOfAnyAreas) {
  // Areas over eight orders of magnitude, and equal ones: the choice is by shares that add up to the budget.
  std::vector<glm::vec3> position;
  std::vector<float> varied, equal;
  std::mt19937 random(5);
  for (int i = 0; i < 20000; ++i) {
    position.emplace_back(random() % 1000, random() % 1000, random() % 1000);
    varied.push_back(std::pow(10.0F, static_cast<float>(random() % 8000) / 1000 - 8));
    equal.push_back(0.25F);
  }
  for (const std::size_t budget : {1U, 100U, 7777U, 19999U}) {
    for (const auto& area_m2 : {varied, equal}) {
      const auto kept = thinned(position, area_m2, budget);
      EXPECT_LE(kept.size(), budget);
      EXPECT_GE(kept.size() + 1, budget);
    }
  }
}

TEST(Sampling, ColoursAreLinearAndFreeOfBackground) {
  const AnalyticScene scene;
  auto views = scene.render_all({look_at({0, 2, 0.01F}, {0, 0, 0}, 32, 32, 0.5F)});
  views[0].light.background = glm::vec3(1, 1, 1);
  for (std::size_t i = 0; i < views[0].pixels(); ++i)
    views[0].color[i] = {188, 188, 188, 128};  // half white, half black
  const SampledRound round = sample(views, {}, unlimited());
  ASSERT_GT(round.samples.size(), 100U);
  EXPECT_NEAR(round.samples.color[0].x, 0, 0.02F);
  EXPECT_NEAR(round.samples.albedo[0].x, linear_from_srgb(200.0F / 255), 1e-4F);
}

TEST(Sampling, TheShareOfTheBackgroundThatAPixelShowsIsTakenOut) {
  const AnalyticScene scene{.ball_centre = {9, 9, 9}, .sheet_centre = {9, 9, 9}};
  auto views = scene.render_all({look_at({0, 2, 0.01F}, {0, 0, 0}, 8, 8, 0.5F)});
  const glm::vec3 surface(0.6F, 0.3F, 0.1F), background(0.2F, 0.5F, 0.9F);
  constexpr std::uint8_t kCoverage = 153;  // three fifths
  const auto as_byte = [](float linear) {
    return static_cast<std::uint8_t>(std::lround(255 * srgb_from_linear(linear)));
  };
  const glm::vec3 seen = 0.6F * surface + 0.4F * background, on_black = 0.6F * surface;
  views[0].light.background = background;
  for (std::size_t i = 0; i < views[0].pixels(); ++i) {
    views[0].color[i] = {as_byte(seen.x), as_byte(seen.y), as_byte(seen.z), kCoverage};
    views[0].albedo[i] = {as_byte(on_black.x), as_byte(on_black.y), as_byte(on_black.z), kCoverage};
  }
  const SampledRound round = sample(views, {}, unlimited());
  ASSERT_GT(round.samples.size(), 10U);
  for (std::size_t i = 0; i < round.samples.size(); ++i) {
    for (int c = 0; c < 3; ++c) {
      ASSERT_NEAR(round.samples.color[i][c], surface[c], 0.01F) << "a byte's rounding";
      ASSERT_NEAR(round.samples.albedo[i][c], surface[c], 0.01F);
    }
  }
}

TEST(Sampling, OfNothingIsNothing) {
  const SampledRound none = sample({}, {}, {});
  EXPECT_EQ(none.samples.size(), 0U);
  const auto sky = AnalyticScene{}.render_all({look_at({0, 2, 0}, {0, 9, 1}, 16, 16, 0.5F)});
  EXPECT_EQ(sample(sky, {}, {}).samples.size(), 0U);
}

/// Two walls that cover the same angle, 4 m and 40 m away: each keeps its half of a small budget, though the far one
/// has a hundred times the area.
TEST(Sampling, WhatIsFarLeavesTheBudgetToWhatIsNear) {
  InputView view = AnalyticScene().render(look_at({0, 5, 0}, {0, 5, -1}, 64, 64, 1));
  for (std::uint32_t i = 0; i < view.pixels(); ++i) {
    const float depth_m = i % 64 < 32 ? 4.0F : 40.0F;
    const glm::vec3 at =
        unproject(view.camera, static_cast<float>(i % 64) + 0.5F, static_cast<float>(i / 64) + 0.5F, depth_m);
    view.position[i] = glm::vec4(at, 0);
    view.normal[i] = glm::vec4(0, 0, 1, 0);
    view.object_id[i] = 1;
    view.color[i] = view.albedo[i] = {9, 9, 9, 255};
  }
  SamplingOptions options = unlimited();
  options.budget = 800;
  const SampledRound round = sample({view}, {}, options);
  const auto near = std::ranges::count_if(round.samples.position, [](const glm::vec3& p) { return p.z > -10; });
  const double share = static_cast<double>(near) / static_cast<double>(round.samples.size());
  // Up to 8 m by area: 4 m count a quarter of what 8 m and all beyond do.
  EXPECT_NEAR(share, 0.2, 0.05);
}

}  // namespace
}  // namespace splatbus::capture_bridge::test

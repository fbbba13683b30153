#include "capture-bridge/sampling.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <iostream>
#include <limits>
#include <map>
#include <set>

#include "analytic_scene.h"
#include "capture-bridge/spacing.h"
#include "capture-bridge/surface.h"
#include "capture-bridge/thinning.h"

namespace splatbus::capture_bridge {
namespace {

using test::AnalyticScene;
using test::small_dome;

SampledRound sample(const std::vector<InputView>& views, const ObjectTransforms& round_objects,
                    const SamplingOptions& options) {
  std::vector<const InputView*> pointers;
  for (const InputView& view : views) pointers.push_back(&view);
  return sample_views(pointers, round_objects, options);
}

/// One view's surface, taken apart.
struct ViewSurface {
  RoundSurface pixels;
  std::vector<float> footprint_m;
  std::vector<bool> edge;
};

ViewSurface analyse_surface(const InputView& view) {
  const InputView* const pointer = &view;
  ViewSurface surface{.pixels = analyse_surfaces(pixel_views({&pointer, 1}, view.objects), {})};
  for (const Texel& texel : surface.pixels.texels) {
    surface.footprint_m.push_back(std::abs(texel.footprint_m));
    surface.edge.push_back(texel.footprint_m < 0);
  }
  return surface;
}

/// No budget, and one camera a surface.
SamplingOptions unlimited() {
  return {.budget = 10'000'000, .cameras_per_surface = 1};
}

/// Nearest kept sample with a similar normal.
float nearest_sample(const SampleSet& samples, const glm::vec3& position, const glm::vec3& normal, std::size_t* which) {
  float nearest = std::numeric_limits<float>::max();
  for (std::size_t i = 0; i < samples.size(); ++i) {
    if (glm::dot(samples.normal[i], normal) < 0.5F) continue;
    const float distance = glm::distance(samples.position[i], position);
    if (distance >= nearest) continue;
    nearest = distance;
    *which = i;
  }
  return nearest;
}

TEST(Footprint, OfAFloorSeenFromAboveIsItsPixel) {
  const Camera camera = look_at({0, 2, 0}, {0, 0, 0}, 64, 64, 1);
  const AnalyticScene scene{.ball_centre = {9, 9, 9}, .sheet_centre = {9, 9, 9}};
  const InputView view = scene.render(camera);
  const ViewSurface surface = analyse_surface(view);
  for (std::size_t i = 0; i < view.pixels(); ++i) {
    ASSERT_NEAR(surface.footprint_m[i], 2 / camera.fx, 1e-4F);
    ASSERT_NEAR(surface.pixels.depth_m[i], 2, 1e-4F);
  }
  EXPECT_EQ(surface.pixels.dropped[0].broken(), 0U);
}

TEST(Footprint, IsTheRootOfThePixelsAreaWhenTheFloorIsSeenObliquely) {
  const Camera camera = look_at({0, 1, 3}, {0, 0, 0}, 64, 64, 0.6F);
  const AnalyticScene scene{.ball_centre = {9, 9, 9}, .sheet_centre = {9, 9, 9}};
  const ViewSurface surface = analyse_surface(scene.render(camera));
  const std::size_t middle = 32 * 64 + 32;
  const float depth = surface.pixels.depth_m[middle];
  const float expected = depth / camera.fx / std::sqrt(surface.pixels.cosine[middle]);
  EXPECT_NEAR(surface.footprint_m[middle], expected, 0.03F * expected);
}

TEST(Footprint, DoesNotLeapOverDiscontinuities) {
  const AnalyticScene scene;
  const Camera camera = look_at({0, 1.5F, 3}, {0, 0.4F, 0}, 96, 96, 1);
  const ViewSurface surface = analyse_surface(scene.render(camera));
  std::size_t edges = 0;
  for (std::size_t i = 0; i < surface.footprint_m.size(); ++i) {
    if (surface.footprint_m[i] == 0) continue;
    edges += surface.edge[i] ? 1 : 0;
    // Never more than the tangent plane allows, with room for the ball's curvature within a pixel.
    EXPECT_LT(surface.footprint_m[i], 2 * surface.pixels.depth_m[i] / camera.fx / std::sqrt(surface.pixels.cosine[i]));
  }
  EXPECT_GT(edges, 50U);
}

TEST(Surface, DropsAndCountsGarbage) {
  const AnalyticScene scene;
  InputView view = scene.render(look_at({0, 2, 0.01F}, {0, 0, 0}, 32, 32, 1));
  const float nan = std::numeric_limits<float>::quiet_NaN();
  view.position[0].x = nan;
  view.position[1].w = std::numeric_limits<float>::infinity();
  view.position[2].w = -1;
  view.normal[3].y = nan;
  view.normal[4] = glm::vec4(0, 3, 0, 0);
  view.position[5] += glm::vec4(5, 0, 0, 0);
  view.normal[6] = -view.normal[6];
  view.normal[7] = glm::vec4(0);
  view.position[8] = glm::vec4(1e30F, 1e30F, 1e30F, 1);
  const ViewSurface surface = analyse_surface(view);
  for (std::size_t i = 0; i < 9; ++i) EXPECT_EQ(surface.footprint_m[i], 0) << i;
  EXPECT_EQ(surface.pixels.dropped[0].not_finite, 4U);
  EXPECT_EQ(surface.pixels.dropped[0].bad_normal, 2U);
  EXPECT_EQ(surface.pixels.dropped[0].off_ray, 2U);
  EXPECT_TRUE(
      std::all_of(surface.footprint_m.begin(), surface.footprint_m.end(), [](float f) { return std::isfinite(f); }));
}

TEST(Sampling, NothingThatIsNotFiniteGetsThrough) {
  const AnalyticScene scene;
  auto views = scene.render_all(small_dome(4, 48));
  for (auto& position : views[1].position) position = glm::vec4(std::numeric_limits<float>::quiet_NaN());
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

TEST(Culling, OfTwoCamerasAtOnePlaceTheFirstKeepsAll) {
  const AnalyticScene scene;
  const Camera camera = look_at({0, 2, 2}, {0, 0, 0}, 64, 64, 1);
  const auto views = scene.render_all({camera, camera});
  const SampledRound round = sample(views, {}, unlimited());
  EXPECT_EQ(round.valid, 2 * round.samples.size());
  EXPECT_TRUE(std::all_of(round.samples.camera.begin(), round.samples.camera.end(), [](auto c) { return c == 0; }));
}

TEST(Culling, TheNearerAndLessObliqueCameraWins) {
  const AnalyticScene scene{.ball_centre = {9, 9, 9}, .sheet_centre = {9, 9, 9}};
  const auto views =
      scene.render_all({look_at({0, 0.6F, 3}, {0, 0, 0}, 64, 64, 1), look_at({0, 2, 0.01F}, {0, 0, 0}, 64, 64, 1)});
  const SampledRound round = sample(views, {}, unlimited());
  for (std::size_t i = 0; i < round.samples.size(); ++i) {
    const glm::vec3& p = round.samples.position[i];
    if (std::abs(p.x) < 0.8F && std::abs(p.z) < 0.8F) {
      ASSERT_EQ(round.samples.camera[i], 1U);
    }
  }
  EXPECT_GT(std::count(round.samples.camera.begin(), round.samples.camera.end(), 0U), 100);
}

TEST(Culling, CoversNothingTwiceAndLeavesNoHoles) {
  const AnalyticScene scene;
  const auto views = scene.render_all(small_dome());
  const SampledRound round = sample(views, {}, unlimited());
  EXPECT_LT(round.samples.size(), round.valid / 2);

  // Holes: whatever any camera saw has a sample nearby. Oblique pixels are long; the winner's spacing is what counts.
  std::size_t seen = 0;
  std::size_t holes = 0;
  for (const InputView& view : views) {
    const ViewSurface surface = analyse_surface(view);
    for (std::size_t i = 0; i < view.pixels(); i += 7) {
      if (surface.footprint_m[i] == 0) continue;
      std::size_t which = 0;
      const float distance =
          nearest_sample(round.samples, glm::vec3(view.position[i]), glm::vec3(view.normal[i]), &which);
      ++seen;
      holes += distance > 1.5F * std::max(round.samples.spacing_m[which], round.samples.footprint_m[which]) ? 1 : 0;
    }
  }
  EXPECT_LT(static_cast<double>(holes), 0.002 * static_cast<double>(seen)) << holes << " of " << seen;

  // Double coverage: a sample of another camera closer than half a spacing only happens along seams.
  std::size_t doubled = 0;
  for (std::size_t i = 0; i < round.samples.size(); ++i) {
    for (std::size_t j = 0; j < round.samples.size(); ++j) {
      if (round.samples.camera[i] == round.samples.camera[j]) continue;
      if (glm::dot(round.samples.normal[i], round.samples.normal[j]) < 0.5F) continue;
      if (glm::distance(round.samples.position[i], round.samples.position[j]) < 0.5F * round.samples.footprint_m[i]) {
        ++doubled;
        break;
      }
    }
  }
  EXPECT_LT(static_cast<double>(doubled), 0.06 * static_cast<double>(round.samples.size()));
}

TEST(Culling, MoreCamerasASurfaceGiveMoreSamples) {
  const auto views = AnalyticScene{}.render_all(small_dome());
  SamplingOptions options = unlimited();
  const std::size_t one = sample(views, {}, options).samples.size();
  options.cameras_per_surface = 3;
  const SampledRound three = sample(views, {}, options);
  EXPECT_GT(three.samples.size(), 2 * one);
  options.cameras_per_surface = 12;
  EXPECT_EQ(sample(views, {}, options).culled, 0U);
}

TEST(Culling, ComparesMovingObjectsAtTheirOwnPlaces) {
  AnalyticScene before;
  AnalyticScene after;
  after.ball_centre += glm::vec3(0.3F, 0, 0);
  const auto cameras = std::vector<Camera>{look_at({0, 2, 2}, {0.6F, 0.3F, 0}, 64, 64, 1),
                                           look_at({0, 2, 2}, {0.6F, 0.3F, 0}, 64, 64, 1)};
  std::vector<InputView> views{before.render(cameras[0]), after.render(cameras[1])};
  views[0].objects[AnalyticScene::kBall] = {.translation = before.ball_centre};
  views[1].objects[AnalyticScene::kBall] = {.translation = after.ball_centre};
  const SampledRound round = sample(views, views[1].objects, unlimited());
  std::size_t ball = 0;
  for (std::size_t i = 0; i < round.samples.size(); ++i) {
    if (round.samples.object_id[i] != AnalyticScene::kBall) continue;
    ++ball;
    EXPECT_NEAR(glm::distance(round.samples.position[i], after.ball_centre), after.ball_radius, 1e-3F);
  }
  // Its own camera alone sees half of the ball in this many pixels; both together no more than a seam above that.
  const ViewSurface alone = analyse_surface(views[0]);
  std::size_t pixels = 0;
  for (std::size_t i = 0; i < views[0].pixels(); ++i)
    pixels += alone.footprint_m[i] > 0 && alone.pixels.object_id[i] == AnalyticScene::kBall;
  EXPECT_GT(ball, pixels * 9 / 10);
  EXPECT_LT(ball, pixels * 14 / 10);
}

TEST(Culling, FillsTheBudgetWithAsManyCamerasAsItHasRoomFor) {
  const auto views = AnalyticScene{}.render_all(small_dome());
  const SampledRound one = sample(views, {}, unlimited());
  const SampledRound tight = sample(views, {}, {.budget = one.samples.size() / 2});
  EXPECT_EQ(tight.cameras_per_surface, 1);
  const SampledRound wide = sample(views, {}, {.budget = 4 * one.samples.size()});
  EXPECT_GE(wide.cameras_per_surface, 2);
  EXPECT_GT(wide.samples.size(), 2 * one.samples.size());
  EXPECT_LE(wide.samples.size(), 4 * one.samples.size());
  EXPECT_EQ(sample(views, {}, {.budget = 10'000'000}).culled, 0U);
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
  const auto spacing = estimate_spacing(position, normal, std::vector<float>(position.size(), 0.03F));
  for (std::size_t i = 0; i < spacing.size(); ++i) {
    // At a border the fourth neighbour is a diagonal one, at a corner the third and the fourth are farther still.
    ASSERT_NEAR(spacing[i], 0.02F, inside[i] ? 1e-5F : 0.36F * 0.02F);
  }
}

TEST(Spacing, OfALoneSampleIsItsFallback) {
  const std::vector<glm::vec3> position{{0, 0, 0}, {5, 0, 0}};
  const std::vector<glm::vec3> normal(2, {0, 1, 0});
  EXPECT_EQ(estimate_spacing(position, normal, std::vector<float>{0.1F, 0.2F}), (std::vector<float>{0.1F, 0.2F}));
  EXPECT_TRUE(estimate_spacing({}, {}, {}).empty());
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
  const auto kept = thin_to_budget(position, area, 100);
  EXPECT_EQ(kept.size(), 100U);
  EXPECT_EQ(std::count_if(kept.begin(), kept.end(), [](auto i) { return i >= 1000; }), 10);
  EXPECT_EQ(std::set<std::uint32_t>(kept.begin(), kept.end()).size(), kept.size());
  EXPECT_EQ(thin_to_budget(position, area, 100), kept);
  EXPECT_EQ(thin_to_budget(position, area, 5000).size(), position.size());
  EXPECT_TRUE(thin_to_budget(position, area, 0).empty());
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

TEST(Sampling, OfNothingIsNothing) {
  const SampledRound none = sample({}, {}, {});
  EXPECT_EQ(none.samples.size(), 0U);
  const auto sky = AnalyticScene{}.render_all({look_at({0, 2, 0}, {0, 9, 1}, 16, 16, 0.5F)});
  EXPECT_EQ(sample(sky, {}, {}).samples.size(), 0U);
}

TEST(Sampling, FullRigFigures) {
  const auto views = AnalyticScene{}.render_all(small_dome(24, 128));
  const auto start = std::chrono::steady_clock::now();
  const SampledRound round = sample(views, {}, {});
  const auto took = std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
  std::cout << "24 x 128x128: " << took << " ms, " << round.valid << " valid, " << round.culled << " culled, "
            << round.samples.size() << " kept\n";
  RecordProperty("milliseconds", std::to_string(took));
  EXPECT_GT(round.samples.size(), 20000U);
}

}  // namespace
}  // namespace splatbus::capture_bridge

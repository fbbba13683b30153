#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <map>
#include <set>

#include "sampled_views.h"

namespace splatbus::capture_bridge::test {
namespace {

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

TEST(Culling, OfCamerasThatSeeAboutAsWellTheFirstKeepsAll) {
  const AnalyticScene scene{.ball_centre = {9, 9, 9}, .sheet_centre = {9, 9, 9}};
  const auto of_second = [&](float distance_m) {
    const auto views = scene.render_all(
        {look_at({0, 2, 0.001F}, {0, 0, 0}, 48, 48, 0.5F), look_at({0, distance_m, 0.001F}, {0, 0, 0}, 48, 48, 0.5F)});
    const SampledRound round = sample(views, {}, unlimited());
    return std::count(round.samples.camera.begin(), round.samples.camera.end(), 1U);
  };
  EXPECT_EQ(of_second(1.9F), 0) << "a pixel's extent is 5 % less";
  EXPECT_EQ(of_second(1.7F), 48 * 48) << "15 % less";
}

/// Colours of pixels beside a silhouette are blended: who sees the same floor undisturbed gives its samples.
TEST(Culling, BesideASilhouetteAnotherCameraWins) {
  const AnalyticScene scene{.sheet_centre = {9, 9, 9}};
  const auto views =
      scene.render_all({look_at({0, 2, 2}, {0, 0, 0}, 64, 64, 1), look_at({0, 2.1F, -2}, {0, 0, 0}, 64, 64, 1)});
  const ViewSurface first = analyse_surface(views[0]), second = analyse_surface(views[1]);
  const SampledRound round = sample(views, {}, unlimited());
  const Camera& other = views[1].camera;
  const Rigid camera_from_world = inverse(other.world_from_camera);
  std::size_t better_seen = 0, kept = 0;
  for (std::size_t i = 0; i < views[0].pixels(); ++i) {
    if (!first.edge[i] || first.footprint_m[i] == 0 || first.object_id[i] != AnalyticScene::kFloor) continue;
    const glm::vec3 local = camera_from_world * glm::vec3(views[0].position[i]);
    const float x = other.fx * local.x / local.z + other.cx, y = other.fy * local.y / local.z + other.cy;
    if (!(x >= 0 && x < 64 && y >= 0 && y < 64)) continue;
    const std::size_t there = static_cast<std::size_t>(y) * 64 + static_cast<std::size_t>(x);
    if (second.edge[there] || second.object_id[there] != AnalyticScene::kFloor) continue;
    if (std::abs(second.depth_m[there] - local.z) > 0.1F || second.footprint_m[there] > 1.5F * first.footprint_m[i])
      continue;
    ++better_seen;
    for (std::size_t k = 0; k < round.samples.size(); ++k) {
      kept += round.samples.camera[k] == 0 && round.samples.pixel[k] == i ? 1 : 0;
    }
  }
  EXPECT_GT(better_seen, 20U);
  EXPECT_EQ(kept, 0U) << "of " << better_seen;
}

TEST(Culling, CoversNothingTwiceAndLeavesNoHoles) {
  const AnalyticScene scene;
  const auto views = scene.render_all(small_dome());
  const SampledRound round = sample(views, {}, unlimited());
  EXPECT_LT(round.samples.size(), round.valid / 2);

  std::vector<ViewSurface> surfaces;
  for (const InputView& view : views) surfaces.push_back(analyse_surface(view));
  const auto footprint_m = [&](std::size_t sample) {
    return surfaces[round.samples.camera[sample]].footprint_m[round.samples.pixel[sample]];
  };

  // Holes: whatever any camera saw has a sample nearby. Oblique pixels are long; the winner's spacing is what counts.
  std::size_t seen = 0;
  std::size_t holes = 0;
  for (std::size_t v = 0; v < views.size(); ++v) {
    const InputView& view = views[v];
    const ViewSurface& surface = surfaces[v];
    for (std::size_t i = 0; i < view.pixels(); i += 7) {
      if (surface.footprint_m[i] == 0) continue;
      std::size_t which = 0;
      const float distance =
          nearest_sample(round.samples, glm::vec3(view.position[i]), glm::vec3(view.normal[i]), &which);
      ++seen;
      holes += distance > 1.5F * std::max(round.samples.spacing_m[which], footprint_m(which)) ? 1 : 0;
    }
  }
  EXPECT_LT(static_cast<double>(holes), 0.002 * static_cast<double>(seen)) << holes << " of " << seen;

  // Double coverage: a sample of another camera closer than half a spacing only happens along seams.
  std::size_t doubled = 0;
  for (std::size_t i = 0; i < round.samples.size(); ++i) {
    for (std::size_t j = 0; j < round.samples.size(); ++j) {
      if (round.samples.camera[i] == round.samples.camera[j]) continue;
      if (glm::dot(round.samples.normal[i], round.samples.normal[j]) < 0.5F) continue;
      if (glm::distance(round.samples.position[i], round.samples.position[j]) < 0.5F * footprint_m(i)) {
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
  views[0].objects[AnalyticScene::kBall] = Rigid{.translation = before.ball_centre};
  views[1].objects[AnalyticScene::kBall] = Rigid{.translation = after.ball_centre};
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
    pixels += alone.footprint_m[i] > 0 && alone.object_id[i] == AnalyticScene::kBall;
  EXPECT_GT(ball, pixels * 9 / 10);
  EXPECT_LT(ball, pixels * 14 / 10);
}

/// A ball of radius 0.25 m in its own frame.
ObjectTransform ball_of(const AnalyticScene& scene) {
  ObjectTransform ball = Rigid{.translation = scene.ball_centre};
  ball.scale = scene.ball_radius / 0.25F;
  return ball;
}

TEST(Culling, WhatHasGrownIsSampledAsItIsNow) {
  AnalyticScene small, large;
  large.ball_radius = 2 * small.ball_radius;
  const Camera camera = look_at({0, 2.5F, 2.5F}, {0.6F, 0.3F, 0}, 64, 64, 1);
  std::vector<InputView> views{small.render(camera), large.render(camera)};
  views[0].objects[AnalyticScene::kBall] = ball_of(small);
  views[1].objects[AnalyticScene::kBall] = ball_of(large);
  const SampledRound round = sample(views, views[1].objects, unlimited());
  std::size_t ball = 0, of_large = 0;
  for (std::size_t i = 0; i < round.samples.size(); ++i) {
    if (round.samples.object_id[i] != AnalyticScene::kBall) continue;
    ++ball;
    of_large += round.samples.camera[i];
    EXPECT_NEAR(glm::distance(round.samples.position[i], large.ball_centre), large.ball_radius, 1e-3F);
    EXPECT_NEAR(glm::length(round.samples.normal[i]), 1, 1e-4F);
  }
  EXPECT_GT(of_large, 200U);
  EXPECT_GT(of_large, ball * 9 / 10) << "it shows more of it";
  // A share of the budget by the area as it is now.
  views.pop_back();
  SamplingOptions tight = unlimited();
  tight.budget = 300;
  const auto balls = [&](const AnalyticScene& now) {
    const ObjectTransforms objects{{AnalyticScene::kBall, ball_of(now)}};
    return std::ranges::count(sample(views, objects, tight).samples.object_id, AnalyticScene::kBall);
  };
  EXPECT_GT(balls(large), balls(small) * 3 / 2);
}

TEST(Culling, WhatIsNotToBeModelledIsNoSample) {
  const AnalyticScene scene;
  std::vector<InputView> views{scene.render(look_at({0, 2, 2}, {0.6F, 0.3F, 0}, 64, 64, 1))};
  views[0].objects[AnalyticScene::kBall] = Rigid{.translation = scene.ball_centre};
  ObjectTransforms round = views[0].objects;
  const auto balls = [&] {
    return std::ranges::count(sample(views, round, unlimited()).samples.object_id, AnalyticScene::kBall);
  };
  EXPECT_GT(balls(), 100);
  round[AnalyticScene::kBall].modelled = false;
  EXPECT_EQ(balls(), 0) << "from now on";
  views[0].objects[AnalyticScene::kBall].modelled = false;
  EXPECT_EQ(balls(), 0);
  round[AnalyticScene::kBall].modelled = true;
  EXPECT_EQ(balls(), 0) << "of before";
}

TEST(Culling, WhatIsGoneFromTheRoundOrWasNoObjectYetIsNoSample) {
  const AnalyticScene scene;
  std::vector<InputView> views{scene.render(look_at({0, 2, 2}, {0.6F, 0.3F, 0}, 64, 64, 1))};
  const auto samples_of_ball = [&](const ObjectTransforms& of_view, const ObjectTransforms& of_round) {
    views[0].objects = of_view;
    const SampledRound round = sample(views, of_round, unlimited());
    EXPECT_GT(round.samples.size(), 500U);
    return std::ranges::count(round.samples.object_id, AnalyticScene::kBall);
  };
  const ObjectTransforms ball{{AnalyticScene::kBall, Rigid{.translation = scene.ball_centre}}};
  EXPECT_GT(samples_of_ball(ball, ball), 100);
  EXPECT_GT(samples_of_ball({}, {}), 100);
  EXPECT_EQ(samples_of_ball(ball, {}), 0);
  EXPECT_EQ(samples_of_ball({}, ball), 0);
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

TEST(Culling, RanksEveryPixelOfPicturesOfAnySize) {
  for (const auto& [width, height] : {std::pair{37U, 53U}, {8U, 9U}, {300U, 1U}, {1U, 1U}, {7U, 64U}}) {
    const auto views = AnalyticScene{}.render_all({look_at({0, 2, 2}, {0, 0, 0}, width, height, 1)});
    const ViewSurface surface = analyse_surface(views[0]);
    std::set<std::uint32_t> valid;
    for (std::uint32_t i = 0; i < views[0].pixels(); ++i) {
      if (surface.footprint_m[i] > 0) valid.insert(i);
    }
    const SampledRound round = sample(views, {}, unlimited());
    EXPECT_EQ(std::set(round.samples.pixel.begin(), round.samples.pixel.end()), valid) << width << " x " << height;
    EXPECT_EQ(round.samples.size(), valid.size());
    EXPECT_FALSE(valid.empty());
  }
}

TEST(Culling, GivesEachSurfaceTheCamerasThatTheBudgetAndAnEighthHaveRoomFor) {
  std::array<std::uint32_t, kRanks> of_rank{};
  of_rank[1] = 1000;
  const auto cameras_with = [&](std::uint32_t of_second_rank, int cameras_per_surface = 0) {
    of_rank[2] = of_second_rank;
    RoundCounts counts;
    const std::size_t survived =
        select_by_budget(of_rank, {.budget = 1000, .cameras_per_surface = cameras_per_surface}, counts);
    EXPECT_EQ(counts.valid, 1000 + of_second_rank);
    EXPECT_EQ(counts.culled, counts.valid - survived);
    EXPECT_EQ(survived, counts.cameras_per_surface == 1 ? 1000U : 1000 + of_second_rank);
    return counts.cameras_per_surface;
  };
  EXPECT_EQ(cameras_with(120), 2) << "1.12 times the budget";
  EXPECT_EQ(cameras_with(130), 1) << "1.13 times the budget";
  EXPECT_EQ(cameras_with(130, 2), 2) << "as was asked for";
  EXPECT_EQ(cameras_with(0), 1) << "no camera is second anywhere";
}

/// Ids are integers of 32 bits: those beyond 2^24 that a float would round together are different objects.
TEST(Culling, TellsObjectsApartByAllBitsOfTheirIds) {
  for (const std::uint32_t first : {0U, 1U << 24U, 0xFFFFFFF0U}) {
    AnalyticScene scene;
    scene.first_object_id = first;
    const auto views = scene.render_all(small_dome(6, 48));
    const SampledRound round = sample(views, {}, unlimited());
    std::map<std::uint32_t, std::size_t> counts;
    for (const std::uint32_t id : round.samples.object_id) ++counts[id];
    ASSERT_EQ(counts.size(), 3U) << first;
    for (const std::uint32_t object : {AnalyticScene::kFloor, AnalyticScene::kBall, AnalyticScene::kSheet}) {
      EXPECT_GT(counts[first + object], 50U) << first << " + " << object;
    }
  }
}

}  // namespace
}  // namespace splatbus::capture_bridge::test

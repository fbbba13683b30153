#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <map>
#include <numeric>
#include <random>
#include <span>

#include "scenes.h"

namespace splatbus::raster::testing {

enum class Wall { None, Opaque, Leaky };

/// A room behind a wall, a yard like it beside the wall, a bush before it, and something outside of the picture:
/// spheres, of each an object of its own, so that each has its page.
struct WalledScene {
  enum Object : std::uint32_t { kRoom = 1, kYard, kWall, kBush, kOutside };

  TestScene scene{radiance_layout(0), 0};
  Camera camera = look_at({0, 0, 4}, {0, 0, 0}, 90, 70, 0.9F);

  explicit WalledScene(Wall wall) {
    std::vector<Ball> balls;
    std::mt19937 random(8);
    const auto within = [&](float low, float high) {
      return low + (high - low) * static_cast<float>(random() >> 8U) * (1.0F / 16777216.0F);
    };
    const auto fill = [&](Object object, std::size_t count, glm::vec3 low, glm::vec3 high, float logit) {
      for (std::size_t k = 0; k < count; ++k) {
        const glm::vec3 mean(within(low.x, high.x), within(low.y, high.y), within(low.z, high.z));
        balls.push_back({object, mean, within(0.02F, 0.06F), logit + within(-1, 1)});
      }
    };
    fill(kRoom, 200, {0.3F, -0.5F, -0.6F}, {0.9F, 0.5F, -0.2F}, 0);
    fill(kYard, 200, {-0.9F, -0.5F, -0.6F}, {-0.3F, 0.5F, -0.2F}, 0);
    fill(kBush, 60, {0.4F, -0.2F, 1.2F}, {0.7F, 0.2F, 1.4F}, -1);
    fill(kOutside, 5, {30, 0, 0}, {31, 1, 1}, 3);
    if (wall == Wall::Leaky) balls.push_back({kWall, {0.5F, 0, 0.6F}, 9, 3.9F});  // 2 % go through
    for (float y = -1.2F; y < 1.2F && wall == Wall::Opaque; y += 0.07F) {
      for (float x = 0.05F; x < 1.4F; x += 0.07F) {
        balls.push_back({kWall, {x, y, 0.6F + within(-0.01F, 0.01F)}, 0.06F, 4});
      }
    }
    scene = TestScene(radiance_layout(0), balls.size());
    for (std::size_t i = 0; i < balls.size(); ++i) {
      for (int c = 0; c < 3; ++c) scene.at(c, i) = balls[i].mean[c];
      for (int c = 3; c < 6; ++c) scene.at(c, i) = std::log(balls[i].radius);
      scene.at(6, i) = 1;
      scene.at(10, i) = balls[i].logit;
      scene.object_id[i] = balls[i].object;
      scene.state.objects[balls[i].object] = ObjectTransform();
    }
  }

  struct Shown {
    double weight_px = 0, error = 0;  ///< the mean by weight
  };
  /// What each object shows, by the book: each pixel blends all there is, in double precision. `error`: of a pixel;
  /// below 0: it does not count. `least_left`: what lies behind less transmittance is hidden.
  [[nodiscard]] std::map<std::uint32_t, Shown> by_hand(const std::function<double(std::uint32_t, std::uint32_t)>& error,
                                                       double least_left = kHiddenTransmittance) {
    struct Spot {
      double x, y, depth, a, b, c, opacity;  // a, b, c: of the covariance's inverse
      std::uint32_t object;
    };
    std::vector<Spot> spots;
    for (std::size_t i = 0; i < scene.count; ++i) {
      const glm::vec3 p = inverse(camera.world_from_camera) * glm::vec3(scene.at(0, i), scene.at(1, i), scene.at(2, i));
      const double x = p.x, y = p.y, z = p.z, fx = camera.fx, fy = camera.fy;
      const double variance = std::exp(2.0 * scene.at(3, i));
      // J J^T of the projection's derivative at the centre.
      const double xx = variance * fx * fx / (z * z) * (1 + x * x / (z * z));
      const double yy = variance * fy * fy / (z * z) * (1 + y * y / (z * z));
      const double xy = variance * fx * fy * x * y / (z * z * z * z);
      const double sharp = xx * yy - xy * xy, blurred = (xx + 0.3) * (yy + 0.3) - xy * xy;
      spots.push_back({.x = fx * x / z + camera.cx,
                       .y = fy * y / z + camera.cy,
                       .depth = z,
                       .a = (yy + 0.3) / blurred,
                       .b = -xy / blurred,
                       .c = (xx + 0.3) / blurred,
                       .opacity = std::sqrt(sharp / blurred) / (1 + std::exp(-double{scene.at(10, i)})),
                       .object = scene.object_id[i]});
    }
    std::ranges::sort(spots, {}, &Spot::depth);
    std::map<std::uint32_t, Shown> shown;
    for (std::uint32_t row = 0; row < camera.height; ++row) {
      for (std::uint32_t column = 0; column < camera.width; ++column) {
        const double of_pixel = error(column, row);
        if (of_pixel < 0) continue;
        double left = 1;
        for (const Spot& spot : spots) {
          if (left < least_left) break;
          if (spot.object == kOutside) continue;
          const double dx = column + 0.5 - spot.x, dy = row + 0.5 - spot.y;
          const double power = 0.5 * (spot.a * dx * dx + 2 * spot.b * dx * dy + spot.c * dy * dy);
          const double alpha = std::min(0.999, spot.opacity * std::exp(-power));
          if (alpha < 1.0 / 255) continue;
          shown[spot.object].weight_px += left * alpha;
          shown[spot.object].error += left * alpha * of_pixel;
          left *= 1 - alpha;
        }
      }
    }
    for (auto& [object, sums] : shown) sums.error /= sums.weight_px;
    return shown;
  }

 private:
  struct Ball {
    Object object;
    glm::vec3 mean;
    float radius, logit;
  };
};

/// Sums of looks by object: each has one page.
struct LookSums {
  std::map<std::uint32_t, double> weight_px, error;
  int looks = 0;

  void add(std::span<const PageLook> seen, std::span<const IndexRange> pages) {
    for (const PageLook& look : seen) {
      const auto page = std::ranges::find(pages, look.page, [](const auto& range) { return range.first / kPageLanes; });
      weight_px[page->frame_id] += static_cast<double>(look.weight_px);
      error[page->frame_id] += static_cast<double>(look.weight_px) * look.error;
    }
    ++looks;
  }
  [[nodiscard]] double weight(std::uint32_t object) const {
    const auto sum = weight_px.find(object);
    return sum == weight_px.end() ? 0 : sum->second / looks;
  }
  [[nodiscard]] double mean_error(std::uint32_t object) const { return error.at(object) / weight_px.at(object); }
};

/// Each pixel has been blended once: they are the truth, and what the wall hides is none of it.
inline void expect_true(const LookSums& sums, WalledScene& scene, Wall wall,
                        const std::function<double(std::uint32_t, std::uint32_t)>& error) {
  auto truth = scene.by_hand(error);
  for (const std::uint32_t object : {WalledScene::kRoom, WalledScene::kYard, WalledScene::kWall, WalledScene::kBush}) {
    EXPECT_NEAR(sums.weight(object), truth[object].weight_px, 0.01 * truth[object].weight_px + 0.05) << object;
    if (truth[object].weight_px < 1) continue;
    EXPECT_NEAR(sums.mean_error(object), truth[object].error, 2e-3) << object;
  }
  EXPECT_EQ(sums.weight(WalledScene::kOutside), 0);
  EXPECT_GT(sums.weight(WalledScene::kBush), 20) << "before the wall";
  const double room = sums.weight(WalledScene::kRoom), yard = sums.weight(WalledScene::kYard);
  if (wall == Wall::None) {
    EXPECT_GT(room, 0.6 * yard) << "the bush hides some";
  } else {
    EXPECT_LT(room, 0.1);
  }
  if (wall == Wall::Leaky) {
    EXPECT_LT(yard, 0.1) << "the wall is before all of it";
    EXPECT_GT(scene.by_hand(error, 0)[WalledScene::kRoom].weight_px, 1) << "some of which gets through";
  } else {
    EXPECT_GT(yard, 100);
  }
}

}  // namespace splatbus::raster::testing

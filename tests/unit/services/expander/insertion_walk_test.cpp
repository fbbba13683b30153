// What a viewer that walks makes of the model: everything once, nearer things finer, far viewers each their own.
#include <algorithm>
#include <array>
#include <cmath>
#include <glm/gtc/constants.hpp>
#include <limits>
#include <random>

#include "insertion_fixture.h"

namespace splatbus::expander::test {
namespace {

struct Box {
  glm::vec3 low, high;
};

/// A floor without end at height 0, and boxes on it.
struct Street {
  std::vector<Box> boxes;

  struct Hit {
    float along_m = std::numeric_limits<float>::infinity();
    glm::vec3 normal{0};
  };
  [[nodiscard]] Hit trace(const glm::vec3& origin, const glm::vec3& direction) const {
    Hit hit;
    if (direction.y < 0) hit = {-origin.y / direction.y, {0, 1, 0}};
    for (const Box& box : boxes) {
      const glm::vec3 to_low = (box.low - origin) / direction, to_high = (box.high - origin) / direction;
      const glm::vec3 enter = glm::min(to_low, to_high), leave = glm::max(to_low, to_high);
      const float along_m = std::max({enter.x, enter.y, enter.z});
      if (along_m <= 0 || along_m >= std::min({leave.x, leave.y, leave.z, hit.along_m})) continue;
      hit = {along_m, glm::vec3(0)};
      const int axis = along_m == enter.x ? 0 : along_m == enter.y ? 1 : 2;
      hit.normal[axis] = direction[axis] > 0 ? -1.0F : 1.0F;
    }
    return hit;
  }
};

/// Houses on both sides of 200 m along x, and things between them.
Street street() {
  Street street;
  std::mt19937 random(3);
  const auto uniform = [&](float low, float high) { return std::uniform_real_distribution<float>(low, high)(random); };
  for (float x = -100; x < 100; x += 9) {
    street.boxes.push_back({{x, 0, -20}, {x + 8, uniform(4, 9), uniform(-8, -5)}});
    street.boxes.push_back({{x, 0, uniform(5, 8)}, {x + 8, uniform(4, 9), 20}});
    const glm::vec3 corner(x + uniform(0, 7), 0, uniform(-4, 3));
    street.boxes.push_back({corner, corner + glm::vec3(uniform(0.3F, 1), uniform(0.3F, 2), uniform(0.3F, 1))});
  }
  return street;
}

/// All around `eye`: a sample in every `step` radians, each turned by `turn`. What is farther than 80 m is not taken.
void look_around(const Street& street, const glm::vec3& eye, float step, float turn, HostRound& round) {
  for (float pitch = -1.5F; pitch < 0.9F; pitch += step) {
    const float yaw_step = step / std::cos(pitch);
    for (float yaw = 0; yaw < glm::two_pi<float>() - yaw_step / 2; yaw += yaw_step) {
      const glm::vec3 direction(std::cos(pitch) * std::cos(yaw + turn), std::sin(pitch + 0.1F * turn * step),
                                std::cos(pitch) * std::sin(yaw + turn));
      const Street::Hit hit = street.trace(eye, glm::normalize(direction));
      if (!(hit.along_m < 80)) continue;
      const float cosine = std::max(-glm::dot(hit.normal, glm::normalize(direction)), 0.0F);
      if (cosine < 0.15F) continue;  // as the capture-bridge's sampler has it
      add_sample(round, eye + hit.along_m * glm::normalize(direction), 1, hit.normal);
      round.spacing_m.back() = hit.along_m * step / std::sqrt(cosine);
    }
  }
}

Viewpoint at(const glm::vec3& eye, float focal_px = 300) {
  const math::Vec3 position{eye.x, eye.y, eye.z};
  return {.position = position, .ahead = position, .focal_px = focal_px};
}

TEST_P(InsertionTest, TheWayBackInsertsNothingTwice) {
  const Street scene = street();
  std::mt19937 random(7);
  std::uniform_real_distribution<float> uniform(-0.15F, 0.15F);
  // How many Gaussians it adds.
  const auto walk = [&](float from_m, float to_m) {
    const std::size_t before = inserter_->modelled().size();
    const float step_m = to_m > from_m ? 0.7F : -0.7F;
    for (float x = from_m; (x < to_m) == (step_m > 0); x += step_m) {
      const glm::vec3 eye(x + uniform(random), 1.6F + 0.1F * uniform(random), uniform(random));
      HostRound round = empty_round();
      look_around(scene, eye, 0.025F, 20 * uniform(random), round);
      viewpoints_ = {at(eye)};
      insert(round);
    }
    return inserter_->modelled().size() - before;
  };
  const std::size_t out = walk(0, 25), back = walk(25, 0), again = walk(0, 25);
  EXPECT_GT(out, 48000U) << "as dense as samples of which each counted alone, at three quarters of its spacing";
  EXPECT_LT(back, out * 3 / 100);
  EXPECT_LT(again, out * 2 / 100);
}

/// A floor seen from ever nearer: as dense as it is seen at last, and no denser.
TEST_P(InsertionTest, WhatComesNearIsRefinedAndNotDoubled) {
  const Street ground;
  std::vector<glm::vec3> points;
  for (const float height_m : {12.0F, 9.0F, 6.0F, 5.0F, 4.0F, 3.0F, 2.5F, 2.0F}) {
    HostRound round = empty_round();
    look_around(ground, {0, height_m, 0}, 0.025F, height_m, round);
    const auto inserted = insert(round).mean;
    points.insert(points.end(), inserted.begin(), inserted.end());
  }
  const auto within = [](const glm::vec3& p) { return glm::length(p) < 1; };
  const auto near = static_cast<double>(std::count_if(points.begin(), points.end(), within));
  const double spacing_m = 2 * 0.025;
  EXPECT_GT(near * spacing_m * spacing_m / glm::pi<double>(), 0.4) << "of one Gaussian a spacing squared";
  EXPECT_LT(near * spacing_m * spacing_m / glm::pi<double>(), 1.6);
  std::size_t bare = 0, looked = 0;
  for (float x = -0.7F; x < 0.7F; x += 0.021F) {
    for (float z = -0.7F; z < 0.7F; z += 0.021F, ++looked) {
      float nearest = INFINITY;
      for (const glm::vec3& p : points) nearest = std::min(nearest, glm::distance(p, glm::vec3(x, 0, z)));
      if (nearest > 1.3F * static_cast<float>(spacing_m)) ++bare;
    }
  }
  EXPECT_LT(bare, looked / 50);
  // From the height of before, and from the first again: all of that is there.
  const std::size_t before = inserter_->modelled().size();
  for (const float height_m : {2.5F, 5.0F, 12.0F}) {
    HostRound round = empty_round();
    look_around(ground, {0, height_m, 0}, 0.025F, 1 + height_m, round);
    insert(round);
  }
  EXPECT_LT(inserter_->modelled().size() - before, before * 3 / 100);
}

TEST_P(InsertionTest, ViewersFarApartGetWhatTheyWouldGetAlone) {
  HostRound both = empty_round();
  std::size_t alone = 0;
  const std::array<glm::vec3, 2> eyes{glm::vec3(-600, 1.6F, 0), glm::vec3(700, 1.6F, 2)};
  const Street ground;  // without end
  for (const glm::vec3& eye : eyes) {
    HostRound round = empty_round();
    look_around(ground, eye, 0.05F, 0.3F, round);
    look_around(ground, eye, 0.05F, 0.3F, both);
    viewpoints_ = {at(eye)};
    use_cells_of(0.2F);
    alone += insert(round).size();
  }
  use_cells_of(0.2F);
  viewpoints_ = {at(eyes[0]), at(eyes[1])};
  EXPECT_EQ(insert(both).size(), alone);
  EXPECT_GT(alone, both.size() * 9 / 10);
  EXPECT_EQ(insert(both).size(), 0U);
}

TEST_P(InsertionTest, ObjectsOfAnyUnitAreModelledAsTheWorldIs) {
  const HostRound plain = floor_round(-1, 1);
  const std::size_t expected = insert(plain).size();
  for (const float scale : {0.01F, 1.0F, 100.0F}) {
    use_cells_of(kCellSize_m);
    HostRound round = plain;
    for (std::uint32_t& id : round.object_id) id = 7;
    round.scene.objects[7] = Rigid{.translation = {1, 2, 3}};
    round.scene.objects[7].scale = scale;
    const HostGaussians inserted = insert(round);
    ASSERT_EQ(inserted.size(), expected) << scale;
    for (std::size_t i = 0; i < inserted.size(); ++i) {
      EXPECT_LT(glm::distance(round.scene.objects[7] * inserted.mean[i], round.position[i]), 1e-5F);
      EXPECT_NEAR(scale * std::exp(inserted.log_scale[i].x), options_.initial.scale * kSpacing, 1e-6F);
    }
    EXPECT_GE(result_.cells.size(), 64U);
    EXPECT_LE(result_.cells.size(), 81U) << "of 0.25 m, whatever the object's unit";
    EXPECT_EQ(insert(round).size(), 0U);
    HostRound finer = empty_round();
    finer.scene = round.scene;
    for (const glm::vec3& p : round.position) {
      for (int k = 0; k < 9; ++k) {
        add_sample(finer, p + kSpacing / 3 * glm::vec3(k / 3 - 1, 0, k % 3 - 1), 7);
        finer.spacing_m.back() = kSpacing / 3;
      }
    }
    EXPECT_GT(insert(finer).size(), 6 * expected) << "what is three times as fine";
  }
}

TEST_P(InsertionTest, WhatNoCellCanNameIsCounted) {
  HostRound round = floor_round(-1, 1);
  const std::size_t near = round.size();
  for (int i = 0; i < 9; ++i) add_sample(round, {0.02F * static_cast<float>(i), 0, 1e6F});
  EXPECT_EQ(insert(round).size(), near);
  EXPECT_EQ(result_.beyond, 9U);
}

}  // namespace
}  // namespace splatbus::expander::test

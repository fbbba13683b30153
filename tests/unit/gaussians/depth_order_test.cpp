#include "gaussians/depth_order.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>

namespace splatbus {
namespace {

using Transform = DepthOrder::Transform;

constexpr Transform kWorld{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0};
constexpr Transform kHidden{};
/// Turned by a quarter about y, twice as large, moved.
constexpr Transform kTurned{0, 0, 2, 1, 0, 2, 0, 2, -2, 0, 0, 30};
constexpr Transform kFarField{250, 0, 0, 0, 0, 250, 0, 256000, 0, 0, 250, 0};
constexpr std::array kTransforms{kWorld, kTurned, kHidden, kFarField};
constexpr std::uint32_t kFarIndex = 3;

struct Row {
  std::array<double, 3> mean;
  std::uint32_t object;
};

class DepthOrderTest : public testing::Test {
 protected:
  DepthOrderTest() {
    std::mt19937 random(5);
    std::uniform_real_distribution<float> near(-20, 20);
    order.resize(5000);
    order.set_transforms(kTransforms, kFarIndex);
    for (std::uint32_t row = 0; row < 5000; ++row) {
      const std::uint32_t object = row % 7 == 0 ? 1 : row % 11 == 0 ? 2 : row % 13 == 0 ? kFarIndex : 0;
      glm::vec3 mean(near(random), near(random), near(random));
      if (object == kFarIndex) mean = glm::vec3(0, -1024, 0) + 4.0F * glm::normalize(mean);
      order.place(row, mean, object);
      rows.push_back({{mean.x, mean.y, mean.z}, object});
    }
  }

  /// In double, a point transformed and then seen.
  [[nodiscard]] double depth(const Row& row, const std::array<float, 4>& z, const std::array<double, 3>& eye) const {
    const Transform& t = kTransforms.at(row.object);
    double depth = z[3];
    for (std::size_t k = 0; k < 3; ++k) {
      double at = t[4 * k + 3] + (row.object == kFarIndex ? eye[k] : 0);
      for (std::size_t c = 0; c < 3; ++c) at += t[4 * k + c] * row.mean[c];
      depth += z[k] * at;
    }
    return depth;
  }

  DepthOrder order;
  std::vector<Row> rows;
};

TEST_F(DepthOrderTest, FarthestFirstWithinAThousandthOfTheDepthAndEachOnce) {
  const glm::dvec3 axis = glm::normalize(glm::dvec3(0.3, -0.2, 0.9));
  const std::array<double, 3> eye{3, 1, -2};
  const std::array<float, 4> z{static_cast<float>(axis.x), static_cast<float>(axis.y), static_cast<float>(axis.z),
                               static_cast<float>(-glm::dot(axis, glm::dvec3(eye[0], eye[1], eye[2])))};
  const auto sorted = order.sort(z);
  std::vector<std::uint8_t> seen(rows.size());
  double last = 1e9;
  bool far_field = false;
  for (const std::uint32_t row : sorted) {
    ASSERT_LT(row, rows.size());
    EXPECT_EQ(seen[row]++, 0);
    EXPECT_NE(rows[row].object, 2U) << "hidden";
    const double at = depth(rows[row], z, eye);
    EXPECT_GT(at, 0.049);
    EXPECT_LT(at, last * 1.001 + 0.01) << row;
    last = at;
    if (rows[row].object == kFarIndex) {
      far_field = true;
      EXPECT_LT(at, 1001);
    }
  }
  EXPECT_TRUE(far_field);
  for (std::size_t row = 0; row < rows.size(); ++row) {
    if (rows[row].object != 2 && !seen[row]) {
      EXPECT_LT(depth(rows[row], z, eye), 0.051) << row;
    }
  }
}

TEST_F(DepthOrderTest, FollowsRowsThatMoveAndHide) {
  const std::array<float, 4> z{0, 0, 1, 0};
  order.resize(3);
  order.set_transforms({&kWorld, 1}, 0);
  order.place(0, {0, 0, 1}, 0);
  order.place(1, {0, 0, 2}, 0);
  order.place(2, {0, 0, 3}, 0);
  const auto sorted = [&] {
    const auto span = order.sort(z);
    return std::vector(span.begin(), span.end());
  };
  EXPECT_EQ(sorted(), (std::vector<std::uint32_t>{2, 1, 0}));
  order.place(0, {0, 0, 2.5F}, 0);
  EXPECT_EQ(sorted(), (std::vector<std::uint32_t>{2, 0, 1}));
  order.hide(2);
  EXPECT_EQ(sorted(), (std::vector<std::uint32_t>{0, 1}));
  order.place(0, {0, 0, 2}, 0);
  EXPECT_EQ(sorted(), (std::vector<std::uint32_t>{0, 1})) << "by row where depths are alike";
  order.place(1, {0, 0, NAN}, 0);
  EXPECT_EQ(sorted(), (std::vector<std::uint32_t>{0}));
  order.place(1, {0, 0, 2}, 8);
  EXPECT_EQ(sorted(), (std::vector<std::uint32_t>{0})) << "of an object that nobody knows";
  order.hide(0);
  EXPECT_TRUE(sorted().empty());
}

}  // namespace
}  // namespace splatbus

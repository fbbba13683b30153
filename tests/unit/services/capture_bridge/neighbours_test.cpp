// The searches for neighbours against looking at every point.
#include <gtest/gtest.h>

#include <algorithm>
#include <random>

#include "capture-bridge/leaf_search.h"

namespace splatbus::capture_bridge {
namespace {

using Found = Nearest<kSearchedNeighbours>;

/// Points in no particular order; many of them in the same place.
std::vector<float> random_points(std::size_t count) {
  std::mt19937 random(static_cast<unsigned>(count));
  std::vector<float> points(3 * count);
  for (float& value : points) value = 0.1F * static_cast<float>(random() % 12);
  return points;
}

Found by_looking_at_all(const std::vector<float>& points, std::uint32_t i) {
  Found found;
  for (std::uint32_t k = 0; k < points.size() / 3; ++k) {
    const Vec3 offset = load3(points.data(), k) - load3(points.data(), i);
    found.add(dot(offset, offset), k);
  }
  return found;
}

void expect_equal(const Found& actual, const Found& expected) {
  ASSERT_EQ(actual.found, expected.found);
  for (int k = 0; k < expected.found; ++k) {
    EXPECT_EQ(actual.index[k], expected.index[k]) << k;
    EXPECT_EQ(actual.distance2[k], expected.distance2[k]) << k;
  }
}

class NeighboursTest : public testing::TestWithParam<std::uint32_t> {};

TEST_P(NeighboursTest, AreTheNearestByDistanceAndThenByIndex) {
  const std::vector<float> points = random_points(GetParam());
  const std::uint32_t leaves = NeighbourTree::leaves_for(GetParam());
  std::vector<Box> nodes(2 * std::size_t{leaves});
  const NeighbourTree tree{points.data(), GetParam(), leaves, nodes.data()};
  for (std::uint32_t leaf = 0; leaf < leaves; ++leaf) tree.build_leaf(leaf);
  for (std::uint32_t node = leaves - 1; node > 0; --node) tree.build_node(node);
  const LeafSearch search(tree);
  for (std::uint32_t i = 0; i < GetParam(); ++i) {
    const Found expected = by_looking_at_all(points, i);
    expect_equal(tree.nearest<kSearchedNeighbours>(i), expected);
    expect_equal(search.nearest(i / LeafSearch::kPoints)[i % LeafSearch::kPoints], expected);
  }
}

INSTANTIATE_TEST_SUITE_P(Counts, NeighboursTest, testing::Values(1, 2, 8, 9, 15, 16, 17, 33, 100, 1000));

}  // namespace
}  // namespace splatbus::capture_bridge

// Keys of cells, and the table of what is known of them.
#include "expander/cell.h"

#include <gtest/gtest.h>

#include <glm/glm.hpp>
#include <limits>
#include <set>

#include "expander/cell_table.h"

namespace splatbus::expander {
namespace {

glm::vec3 centre(const CellKey& key) {
  const math::Vec3 at = cell_centre(key, 0.25F);
  return {at.x, at.y, at.z};
}

TEST(Cell, PacksAndFindsNeighbours) {
  const CellKey cell = cell_at({1.3F, -0.6F, 0.05F}, 0, 0.25F);
  ASSERT_FALSE(cell.none());
  EXPECT_EQ(cell.object_id, 0U);
  EXPECT_EQ(centre(cell), glm::vec3(1.25F, -0.5F, 0));
  EXPECT_EQ(centre(neighbour(cell, -1, 1, 2)), glm::vec3(1, -0.25F, 0.5F));
  EXPECT_TRUE(neighbour(neighbour(cell, 3, -2, 1), -3, 2, -1) == cell);
}

TEST(Cell, AFloorAtZeroLiesInOneLayer) {
  EXPECT_TRUE(cell_at({0.6F, 1e-6F, 0.6F}, 0, 0.25F) == cell_at({0.6F, -1e-6F, 0.6F}, 0, 0.25F));
}

TEST(Cell, ObjectsHaveCellsOfTheirOwn) {
  // 1 and 1 + 2^18 agree in 18 bits, 1 and 2^31 + 1 in 31.
  std::set<CellKey> cells;
  for (const std::uint32_t id : {0U, 1U, 2U, 1U + (1U << 18U), (1U << 31U) + 1U, 0xFFFFFFFFU}) {
    const CellKey cell = cell_at({0.1F, 0.2F, -0.3F}, id, 0.25F);
    EXPECT_EQ(cell.object_id, id);
    EXPECT_EQ(centre(cell), glm::vec3(0, 0.25F, -0.25F));
    EXPECT_TRUE(cell < CellKey{}) << "what has no cell comes last";
    cells.insert(cell);
  }
  EXPECT_EQ(cells.size(), 6U);
}

TEST(Cell, WhatIsTooFarOrNoNumberHasNone) {
  EXPECT_TRUE(cell_at({1e9F, 0, 0}, 0, 0.25F).none());
  EXPECT_TRUE(cell_at({std::numeric_limits<float>::quiet_NaN(), 0, 0}, 0, 0.25F).none());
  EXPECT_TRUE(cell_at({0, std::numeric_limits<float>::infinity(), 0}, 1, 0.25F).none());
  const CellKey last = cell_at({((1 << 20) - 1) * 0.25F, 0, 0}, 0, 0.25F);
  ASSERT_FALSE(last.none());
  EXPECT_TRUE(neighbour(last, 1, 0, 0).none());
  EXPECT_TRUE(cell_at({(1 << 20) * 0.25F, 0, 0}, 0, 0.25F).none());
  EXPECT_FALSE(cell_at({(1 << 20) * -0.25F, 0, 0}, 0, 0.25F).none());
  EXPECT_TRUE(cell_at({(1 << 20) * -0.25F - 0.25F, 0, 0}, 0, 0.25F).none());
}

class CellTableTest : public testing::Test {
 protected:
  static CellCount cell(int x, std::uint32_t count) { return {pack_cell({x, 0, 0}, 0), count}; }
  /// x, samples and points of what has changed.
  std::set<std::tuple<std::int64_t, unsigned, unsigned>> changed(std::size_t max = 100) {
    std::set<std::tuple<std::int64_t, unsigned, unsigned>> cells;
    for (const CellReport& report : table_.take_changed(max)) {
      cells.insert({unpack_cell(report.key).x, report.samples, report.modelled});
    }
    return cells;
  }
  using Cells = std::set<std::tuple<std::int64_t, unsigned, unsigned>>;
  CellTable table_{4};
};

TEST_F(CellTableTest, TellsWhatHasChangedOnce) {
  table_.set_samples(std::vector{cell(1, 10), cell(2, 20)});
  table_.set_modelled(std::vector{cell(2, 7), cell(3, 9)});
  EXPECT_EQ(table_.seen(), 2U);
  EXPECT_EQ(table_.modelled(), 2U);
  EXPECT_EQ(changed(), (Cells{{1, 10, 0}, {2, 20, 7}, {3, 0, 9}}));
  EXPECT_FALSE(table_.changed());
  table_.set_samples(std::vector{cell(1, 10), cell(2, 21)});
  EXPECT_EQ(changed(), (Cells{{2, 21, 7}}));
  table_.set_modelled(std::vector{cell(2, 7)});
  EXPECT_EQ(table_.modelled(), 1U);
  EXPECT_EQ(changed(), (Cells{{3, 0, 0}})) << "what the model has no longer";
  EXPECT_EQ(table_.size(), 2U) << "and is forgotten";
  table_.touch_all();
  EXPECT_EQ(changed(1).size(), 1U);
  EXPECT_EQ(changed().size(), 1U);
}

TEST_F(CellTableTest, HoldsAsManyAsItMay) {
  table_.set_samples(std::vector{cell(1, 1), cell(2, 1), cell(3, 1), cell(4, 1), cell(5, 1)});
  EXPECT_TRUE(table_.full());
  EXPECT_EQ(table_.size(), 4U);
  EXPECT_EQ(table_.seen(), 4U);
  table_.set_modelled(std::vector{cell(2, 3), cell(6, 1)});
  EXPECT_EQ(table_.modelled(), 1U);
}

}  // namespace
}  // namespace splatbus::expander

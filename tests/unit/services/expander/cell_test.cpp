// Keys of cells, and the table of what is known of them.
#include "expander/cell.h"

#include <gtest/gtest.h>

#include <cmath>
#include <glm/glm.hpp>
#include <limits>
#include <set>

#include "expander/cell_table.h"
#include "expander/filled_cells.h"

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
  const CellKey last = cell_at({((1 << 17) - 1) * 0.25F, 0, 0}, 0, 0.25F);
  ASSERT_FALSE(last.none());
  EXPECT_TRUE(neighbour(last, 1, 0, 0).none());
  EXPECT_TRUE(cell_at({(1 << 17) * 0.25F, 0, 0}, 0, 0.25F).none());
  EXPECT_FALSE(cell_at({(1 << 17) * -0.25F, 0, 0}, 0, 0.25F).none());
  EXPECT_TRUE(cell_at({(1 << 17) * -0.25F - 0.25F, 0, 0}, 0, 0.25F).none());
}

/// Coordinates of the cells of a level by division, far from the origin too.
TEST(Cell, LevelsLieInOneAnother) {
  for (const float cell_size_m : {0.2F, 0.25F}) {
    for (const glm::vec3& p :
         {glm::vec3(0.01F, -0.01F, 3.01F), glm::vec3(-999.99F, 999.51F, 0.31F), glm::vec3(999.99F, -3.01F, 77.01F)}) {
      for (unsigned level = 0; level < kLevels; ++level) {
        const double edge_m = cell_size_m / 8.0 * std::exp2(level);
        const glm::dvec3 expected = glm::floor((glm::dvec3(p) + 0.5 * cell_size_m) / edge_m);
        const CellKey cell = cell_at({p.x, p.y, p.z}, 5, cell_size_m, level);
        const CellCoordinates at = unpack_cell(cell);
        ASSERT_EQ(glm::dvec3(at.x, at.y, at.z), expected) << p.x << " at level " << level;
        EXPECT_TRUE(pack_cell(at, 5, level) == cell);
        EXPECT_TRUE(parent_of(cell_at({p.x, p.y, p.z}, 5, cell_size_m, 0), level) == cell);
        const math::Vec3 centre = cell_centre(cell, cell_size_m);
        EXPECT_LE(std::abs(centre.x - p.x), 0.5001 * edge_m);
        EXPECT_LE(std::abs(centre.y - p.y), 0.5001 * edge_m);
        EXPECT_FLOAT_EQ(edge_of(level, cell_size_m), static_cast<float>(edge_m));
        EXPECT_EQ(level_of(static_cast<float>(0.9 * edge_m), cell_size_m), level);
      }
    }
  }
}

TEST(Cell, WhatLiesInACellFollowsOneAnother) {
  const CellKey cell = cell_at({3, -2, 9}, 1, 0.25F, 5);
  const CellKey inside = cell_at(cell_centre(cell, 0.25F), 1, 0.25F, 2);
  const CellKey first = first_in(cell, 2), end = first_in(next_of(cell), 2);
  EXPECT_TRUE(!(inside < first) && inside < end);
  EXPECT_EQ(end.code - first.code, 8U * 8U * 8U);
  for (int k = 0; k < 27; ++k) {
    const CellKey beside = neighbour(cell, k / 9 - 1, k / 3 % 3 - 1, k % 3 - 1);
    EXPECT_EQ(k == 13, beside == cell);
    const CellKey within = cell_at(cell_centre(beside, 0.25F), 1, 0.25F, 2);
    EXPECT_EQ(!(within < first) && within < end, k == 13);
  }
}

TEST(FilledCells, AreFilledAgainByFinerSamplesOrWhereMuchIsMissing) {
  FilledCells cells;
  const CellKey cell = cell_at({1, 2, 3}, 0, 0.25F, 3), larger = parent_of(cell, 4);
  EXPECT_FALSE(cells.fill(larger, 0.1F, 1.4F, false)) << "somebody has filled it before";
  EXPECT_FALSE(cells.fill(larger, 0.08F, 1.4F, false));
  EXPECT_FALSE(cells.fill(cell, 0.06F, 1.4F, false)) << "the larger cell was filled at 0.1";
  EXPECT_TRUE(cells.fill(cell, 0.055F, 1.4F, false));
  EXPECT_FALSE(cells.fill(cell, 0.04F, 1.4F, false));
  EXPECT_TRUE(cells.fill(cell, 0.09F, 1.4F, true));
  EXPECT_TRUE(cells.fill(cell, 0.06F, 1.4F, false)) << "coarser than before, since points are missing";
  cells.clear();
  EXPECT_EQ(cells.size(), 0U);
}

TEST(FilledCells, ACellWhoseChildrenWereFilledIsNotFilledForWhatItsParentLacks) {
  FilledCells cells;
  const CellKey cell = cell_at({1, 2, 3}, 0, 0.25F, 4);
  EXPECT_FALSE(cells.fill(parent_of(cell, 5), 0.2F, 1.4F, false));
  EXPECT_FALSE(cells.fill(first_in(cell, 3), 0.15F, 1.4F, false));
  // Its parent's 0.2 is more than 1.4 x 1.25 x 0.1, but what is in it was filled from nearer.
  EXPECT_FALSE(cells.fill(cell, 0.1F, 1.4F, false));
}

class CellTableTest : public testing::Test {
 protected:
  static CellCount cell(int x, std::uint32_t count) { return {pack_cell({x, 0, 0}, 0, kReportLevel), count}; }
  /// x, samples and points of what is told.
  using Cells = std::multiset<std::tuple<std::int64_t, unsigned, unsigned>>;
  Cells take(std::size_t max, std::size_t repeats) {
    Cells cells;
    for (const CellReport& report : table_.take(max, repeats)) {
      cells.insert({unpack_cell(report.key).x, report.samples, report.modelled});
    }
    return cells;
  }
  Cells changed() { return take(100, 0); }
  CellTable table_{4};
};

TEST_F(CellTableTest, TellsWhatHasChangedOnce) {
  table_.set_samples(std::vector{cell(1, 10), cell(2, 20)});
  table_.add_modelled(std::vector{cell(2, 4), cell(3, 9)});
  table_.add_modelled(std::vector{cell(2, 3)});
  EXPECT_EQ(table_.seen(), 2U);
  EXPECT_EQ(table_.modelled(), 2U);
  EXPECT_EQ(changed(), (Cells{{1, 10, 0}, {2, 20, 7}, {3, 0, 9}}));
  EXPECT_FALSE(table_.changed());
  table_.set_samples(std::vector{cell(1, 10), cell(2, 21)});
  EXPECT_EQ(changed(), (Cells{{2, 21, 7}}));
  table_.remove_modelled(std::vector{cell(2, 7)});
  table_.add_modelled(std::vector{cell(2, 7)});
  EXPECT_EQ(changed(), Cells()) << "as it was";
  table_.remove_modelled(std::vector{cell(2, 3), cell(3, 9)});
  EXPECT_EQ(table_.modelled(), 1U);
  EXPECT_EQ(changed(), (Cells{{2, 21, 4}, {3, 0, 0}})) << "what the model has no longer";
  EXPECT_EQ(table_.size(), 2U) << "and is forgotten";
  EXPECT_EQ(table_.modelled_of(cell(2, 0).key), 4U);
  EXPECT_EQ(table_.modelled_of(cell(3, 0).key), 0U);
}

TEST_F(CellTableTest, TheOthersAreFoundAsBeforeWhenOneIsForgotten) {
  table_.add_modelled(std::vector{cell(1, 10), cell(2, 20), cell(3, 30)});
  EXPECT_EQ(changed().size(), 3U);
  table_.remove_modelled(std::vector{cell(1, 10)});
  EXPECT_EQ(changed(), (Cells{{1, 0, 0}}));
  table_.add_modelled(std::vector{cell(4, 40), cell(3, 3)});
  EXPECT_EQ(table_.modelled_of(cell(2, 0).key), 20U);
  EXPECT_EQ(table_.modelled_of(cell(3, 0).key), 33U);
  EXPECT_EQ(table_.modelled_of(cell(4, 0).key), 40U);
  EXPECT_EQ(changed(), (Cells{{3, 0, 33}, {4, 0, 40}}));
  EXPECT_EQ(take(5, 5), (Cells{{2, 0, 20}, {3, 0, 33}, {4, 0, 40}}));
}

TEST_F(CellTableTest, TellsTheOthersAgainInTurn) {
  table_.set_samples(std::vector{cell(1, 10), cell(2, 20), cell(3, 30)});
  EXPECT_EQ(take(2, 2).size(), 2U) << "what has changed comes first";
  EXPECT_EQ(take(2, 0).size(), 1U);
  const Cells all{{1, 10, 0}, {2, 20, 0}, {3, 30, 0}};
  for (int turn = 0; turn < 3; ++turn) {
    Cells told;
    for (int i = 0; i < 3; ++i) told.merge(take(5, 1));
    EXPECT_EQ(told, all);
  }
  EXPECT_EQ(take(5, 5), all) << "each once a message";
}

TEST_F(CellTableTest, HoldsAsManyAsItMay) {
  table_.set_samples(std::vector{cell(1, 1), cell(2, 1), cell(3, 1), cell(4, 1), cell(5, 1)});
  EXPECT_TRUE(table_.full());
  EXPECT_EQ(table_.size(), 4U);
  EXPECT_EQ(table_.seen(), 4U);
  table_.add_modelled(std::vector{cell(2, 3), cell(6, 1)});
  EXPECT_EQ(table_.modelled(), 1U);
  table_.remove_modelled(std::vector{cell(2, 3), cell(6, 1)});
  EXPECT_EQ(table_.modelled(), 0U);
}

}  // namespace
}  // namespace splatbus::expander

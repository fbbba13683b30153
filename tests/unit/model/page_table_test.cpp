#include "model/page_table.h"

#include <gmock/gmock.h>

#include <cstddef>
#include <vector>

namespace splatbus::model {

namespace {

class PageTableTest : public testing::Test {
 protected:
  PageTableTest() : memory_(page_table_bytes(kArenaPages) / 64 + 1) {
    PageTable::begin(bytes(), {}, kArenaPages).header().arenas[0].count = 1;
  }

  /// Whoever comes after a death.
  PageTable next_writer() {
    std::string why_not;
    const auto table = PageTable::adopt(bytes(), memory_.size() * 64, {}, why_not);
    if (!table) throw std::logic_error(why_not);
    static_cast<void>(table->recover());
    return *table;
  }

  static PageStructure active(std::uint32_t count) { return {.state = PageState::Active, .count = count}; }

  struct alignas(64) Line {
    std::byte bytes[64];
  };
  std::byte* bytes() { return memory_.front().bytes; }
  std::vector<Line> memory_;
};

TEST_F(PageTableTest, WhatWasProposedAndNeverCommittedDoesNotComeBackWithALaterChange) {
  next_writer().propose(3, active(7));
  const PageTable second = next_writer();
  second.propose(4, active(8));
  second.commit(9, BatchKey{1, 5});
  const PageTable third = next_writer();
  EXPECT_EQ(third.entry(3).now.state, PageState::Free);
  EXPECT_EQ(third.entry(4).now.count, 8U);
  EXPECT_EQ(third.header().next_gaussian_id, 9U);
  EXPECT_TRUE(third.holds({1, 5}));
}

TEST_F(PageTableTest, TheLatestBatchesOfAnEpochAreRemembered) {
  const PageTable table = next_writer();
  for (std::uint64_t batch = 0; batch < kRememberedBatches + 10; ++batch) {
    table.commit(1, BatchKey{2, batch});
    table.close();
  }
  EXPECT_FALSE(table.holds({2, 9}));
  EXPECT_TRUE(table.holds({2, 10}));
  EXPECT_EQ(table.batches().size(), kRememberedBatches);
  EXPECT_EQ(table.batches().back(), kRememberedBatches + 9);
  EXPECT_THAT(next_writer().batches(), testing::ContainerEq(table.batches())) << "a change is folded once";
}

TEST_F(PageTableTest, ATableThatContradictsItselfIsRefused) {
  std::string why_not;
  const PageTable table = next_writer();
  table.entry(3).now = active(kPageLanes + 1);
  EXPECT_FALSE(PageTable::adopt(bytes(), memory_.size() * 64, {}, why_not));
  table.entry(3).now = {};
  EXPECT_TRUE(PageTable::adopt(bytes(), memory_.size() * 64, {}, why_not));
  EXPECT_FALSE(PageTable::adopt(bytes(), sizeof(PageTableHeader) + 5, {}, why_not));
  EXPECT_FALSE(PageTable::adopt(bytes(), 5, {}, why_not));
}

}  // namespace

}  // namespace splatbus::model

#include "stream/replicated_state.h"

#include <gtest/gtest.h>

#include <set>


namespace splatbus::stream {
namespace {

std::set<std::uint32_t> insert(ReplicatedState& state, std::uint32_t number) {
  Change change;
  HeldPage& page = state.pages[number];
  state.set_count(page, kPageLanes, change);
  return {page.blocks.begin(), page.blocks.begin() + HeldPage::blocks_of(page.count)};
}

// What has gone is faded out in its rows (row_feed.h, row_mirror.ts).
TEST(ReplicatedState, RowsRestBeforeAnotherPageHasThem) {
  ReplicatedState state;
  state.gaussians = HeldGaussians(state.layout);
  constexpr std::uint32_t kPages = 40, kAtOnce = 3;
  for (std::uint32_t page = 0; page < kPages; ++page) insert(state, page);
  std::size_t rows = 0;
  for (std::uint32_t round = 0; round < 200; ++round) {
    Change change;
    std::set<std::uint32_t> gone;
    for (std::uint32_t k = 0; k < kAtOnce; ++k) {
      const HeldPage& page = state.pages.begin()->second;
      gone.insert(page.blocks.begin(), page.blocks.end());
      state.drop(state.pages.begin()->first, change);
    }
    for (std::uint32_t k = 0; k < kAtOnce; ++k) {
      for (const std::uint32_t block : insert(state, kPages + round * kAtOnce + k)) EXPECT_EQ(gone.count(block), 0U);
    }
    if (round == 20) rows = state.rows();
  }
  EXPECT_EQ(state.rows(), rows) << "they are used again";
}

}  // namespace
}  // namespace splatbus::stream

// Which changes a tick sends: by what they show, over what they cost.
#include "stream/delta_selection.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <set>
#include <unordered_map>
#include <vector>

#include "toy_server.h"

namespace splatbus::stream {
namespace {

class DeltaSelectionTest : public testing::Test {
 protected:
  DeltaSelectionTest() : columns_(held().rows(), kNotHeld), share_(columns_.size(), 1) {
    const HeldPage& page = *held().find(0);
    for (std::uint32_t lane = 0; lane < page.count; ++lane) {
      const std::uint64_t id = held().gaussians.gaussian_id[page.row(lane)];
      columns_[page.row(lane)] =
          static_cast<std::uint32_t>(std::ranges::find(target_.gaussian_id, id) - target_.gaussian_id.begin());
    }
    for (std::uint32_t row = 0; row < columns_.size(); ++row) selection_.begin(row, held().gaussians);
    for (std::uint32_t block = 0; block < columns_.size() / kBlockRows; ++block) blocks_.push_back(block);
  }
  [[nodiscard]] const ReplicatedState& held() const { return server_.stream.held(); }
  [[nodiscard]] std::uint32_t row(std::uint32_t lane) const { return held().find(0)->row(lane); }
  void redden(std::uint32_t lane, std::int32_t steps) {
    target_.channels[held().layout.at(Attribute::Albedo).first][columns_[row(lane)]] += steps;
  }
  std::vector<std::uint32_t> chosen(double budget_bytes) {
    std::vector<std::uint32_t> rows;
    for (const SelectedRows& of :
         selection_.select(held().gaussians, target_, columns_, blocks_, share_, budget_bytes)) {
      rows.insert(rows.end(), of.rows.begin(), of.rows.end());
    }
    return rows;
  }

  test::ToyServer server_{5, 500};
  QuantizedGaussians target_ = server_.stream.observed_gaussians();
  DeltaSelection selection_ = [&] {
    DeltaSelection selection(held().layout, default_schedules());
    selection.resize(held().rows());
    return selection;
  }();
  std::vector<std::uint32_t> columns_, blocks_;
  std::vector<float> share_;
};

TEST_F(DeltaSelectionTest, ALargeChangeIsNoMoreUrgentThanOneThatIsSeenToBeWrong) {
  redden(3, 4000);
  redden(7, 100);
  share_[row(7)] = 2;
  EXPECT_EQ(chosen(1.01 * selection_.bytes_per_entry(Attribute::Albedo)), (std::vector<std::uint32_t>{row(7)}));
  EXPECT_EQ(selection_.pending(), 1U);
}

TEST_F(DeltaSelectionTest, WhatEntriesCostIsLearntFromPacketsOfMany) {
  const double first = selection_.bytes_per_entry(Attribute::Albedo);
  selection_.learn_cost(Attribute::Albedo, 31, 3100);
  EXPECT_EQ(selection_.bytes_per_entry(Attribute::Albedo), first) << "a packet's frame is most of a small one";
  selection_.learn_cost(Attribute::Albedo, 100, 800);
  EXPECT_DOUBLE_EQ(selection_.bytes_per_entry(Attribute::Albedo), (first + 8) / 2);
}

TEST_F(DeltaSelectionTest, ABudgetHasRoomForWhatItsEntriesCost) {
  for (std::uint32_t lane = 0; lane < 400; ++lane) redden(lane, 30);
  for (int k = 0; k < 20; ++k) selection_.learn_cost(Attribute::Albedo, 100, 500);
  EXPECT_NEAR(static_cast<double>(chosen(500).size()), 100, 2);
}

/// However many workers look at them.
TEST(DeltaSelectionOfMany, TakesRowsInTheirOrderAndSaysWhereTheOthersAre) {
  constexpr std::uint32_t kPages = 40, kEvery = 37;
  const test::ToyServer server(5, std::size_t{kPages} * kPageLanes);
  const ReplicatedState& held = server.stream.held();
  QuantizedGaussians target = server.stream.observed_gaussians();
  std::unordered_map<std::uint64_t, std::uint32_t> column_of;
  for (std::uint32_t c = 0; c < target.count(); ++c) column_of[target.gaussian_id[c]] = c;
  DeltaSelection selection(held.layout, default_schedules());
  selection.resize(held.rows());
  std::vector<std::uint32_t> columns(held.rows(), kNotHeld), blocks, reddened;
  for (const auto& [number, page] : held.pages) {
    for (std::uint32_t lane = 0; lane < page.count; ++lane) {
      const std::uint32_t row = page.row(lane);
      columns[row] = column_of.at(held.gaussians.gaussian_id[row]);
    }
  }
  for (std::uint32_t row = 0; row < columns.size(); ++row) {
    selection.begin(row, held.gaussians);
    if (row % kBlockRows == 0) blocks.push_back(row / kBlockRows);
    if (columns[row] == kNotHeld || row % kEvery != 0) continue;
    target.channels[held.layout.at(Attribute::Albedo).first][columns[row]] += 30;
    reddened.push_back(row);
  }
  ASSERT_GT(blocks.size(), 100U);
  const std::vector<float> share(columns.size(), 1);
  const auto select = [&](double bytes) {
    return selection.select(held.gaussians, target, columns, blocks, share, bytes);
  };
  const auto all = select(1e9);
  ASSERT_EQ(all.size(), 1U);
  EXPECT_EQ(all[0].rows, reddened);
  EXPECT_EQ(selection.pending(), 0U);
  EXPECT_TRUE(selection.left_blocks().empty());

  const double half = 0.5 * static_cast<double>(reddened.size()) * selection.bytes_per_entry(Attribute::Albedo);
  const auto some = select(half);
  ASSERT_EQ(some.size(), 1U);
  const std::size_t taken = some[0].rows.size();
  EXPECT_NEAR(static_cast<double>(taken), 0.5 * static_cast<double>(reddened.size()), 1);
  EXPECT_TRUE(std::equal(some[0].rows.begin(), some[0].rows.end(), reddened.begin())) << "of equal worth the first";
  EXPECT_EQ(selection.pending(), reddened.size() - taken);
  std::set<std::uint32_t> left;
  for (std::size_t k = taken; k < reddened.size(); ++k) left.insert(reddened[k] / kBlockRows);
  EXPECT_EQ(selection.left_blocks(), std::vector<std::uint32_t>(left.begin(), left.end()));
}

}  // namespace
}  // namespace splatbus::stream

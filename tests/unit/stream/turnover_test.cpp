// What becomes of the Gaussians of rows, against the ids that the server knows and viewers do not.
#include <gtest/gtest.h>

#include <map>
#include <set>

#include "stream/gpu_rows.h"
#include "toy_server.h"

namespace splatbus::stream {
namespace {

using test::ToyServer;
using IdsByRow = std::map<std::uint32_t, std::uint64_t>;

IdsByRow ids_by_row(const ToyServer& server, const Replica& replica) {
  IdsByRow out;
  test::for_each_held(server, replica, [&](std::uint64_t id, std::uint32_t row) { out[row] = id; });
  return out;
}

std::set<std::uint64_t> ids_of(const IdsByRow& by_row) {
  std::set<std::uint64_t> out;
  for (const auto& [row, id] : by_row) out.insert(id);
  return out;
}

/// How many rows are asked for at once.
class GpuRowsTurnover : public testing::TestWithParam<std::size_t> {
 protected:
  /// One call; what is taken is in `shown_` then.
  void take(const IdsByRow& truth) {
    std::vector<std::uint32_t> rows;
    std::vector<GpuRecord> records;
    GpuRows::Turnover turnover;
    gpu_.take_records(GetParam(), rows, records, nullptr, &turnover);
    ASSERT_EQ(turnover.origins.size(), rows.size());
    ASSERT_EQ(turnover.left.size(), rows.size());
    ASSERT_EQ(std::set(rows.begin(), rows.end()).size(), rows.size()) << "each once";
    const IdsByRow before = shown_;
    const std::set<std::uint64_t> were = ids_of(before), are = ids_of(truth);
    for (std::size_t i = 0; i < rows.size(); ++i) {
      const auto was = before.find(rows[i]), is = truth.find(rows[i]);
      const std::uint32_t origin = turnover.origins[i];
      shown_.erase(rows[i]);
      if (is != truth.end()) {
        shown_[rows[i]] = is->second;
        EXPECT_EQ(origin == GpuRows::kNoRow, !were.contains(is->second)) << "row " << rows[i];
        if (origin == GpuRows::kNoRow) {
          ++arrived_;
        } else {
          ASSERT_TRUE(before.contains(origin));
          EXPECT_EQ(before.at(origin), is->second) << "row " << rows[i];
          moved_ += origin != rows[i] ? 1 : 0;
        }
      }
      if (was == before.end()) continue;
      const bool left = !are.contains(was->second);
      EXPECT_EQ(turnover.left[i] != 0, left) << "row " << rows[i];
      left_ += left ? 1 : 0;
    }
    // Whatever is still to come: nobody is there twice, and who is there and was is not away meanwhile.
    const std::set<std::uint64_t> now = ids_of(shown_);
    EXPECT_EQ(now.size(), shown_.size());
    for (const std::uint64_t id : were) EXPECT_TRUE(now.contains(id) || !are.contains(id)) << "Gaussian " << id;
  }

  Replica replica_;
  GpuRows gpu_{replica_};
  IdsByRow shown_;  ///< by who takes the rows
  std::size_t arrived_ = 0, left_ = 0, moved_ = 0;
};

// Of one page: between two Gaussians go over as if they left and arrived.
TEST_P(GpuRowsTurnover, WhatArrivesAndLeavesIsToldFromWhatMoves) {
  ToyServer server(21, 700);
  test::join(server.stream, replica_);
  while (gpu_.unsent() > 0) take(ids_by_row(server, replica_));
  EXPECT_EQ(arrived_, 700U);
  for (int turn = 0; turn < 40; ++turn) {
    for (int k = 0; k < 1 + turn % 3; ++k) {  // that nobody has taken in between
      server.train(0.01F);
      if ((turn + k) % 3 == 0) server.remove(60);
      if ((turn + k) % 3 == 1) server.insert(60);
      server.tick_for(replica_);
    }
    take(ids_by_row(server, replica_));
    if (turn % 4 == 3) {
      while (gpu_.unsent() > 0 && !HasFailure()) take(ids_by_row(server, replica_));
      EXPECT_EQ(shown_, ids_by_row(server, replica_));
    }
    if (HasFailure()) FAIL() << "turn " << turn;
  }
  EXPECT_GT(arrived_, 1200U);
  EXPECT_GT(left_, 500U);
  EXPECT_GT(moved_, 300U);
}

INSTANTIATE_TEST_SUITE_P(AtOnce, GpuRowsTurnover, testing::Values(64, 256, 100'000));

}  // namespace
}  // namespace splatbus::stream

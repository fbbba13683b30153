// What becomes of the Gaussians of rows, against the ids that the server knows and viewers do not.
#include <gtest/gtest.h>

#include <map>
#include <set>

#include "stream/gpu_rows.h"
#include "toy_server.h"

namespace splatbus::stream {
namespace {

using test::ToyServer;

/// The Gaussian of each row that is held.
std::map<std::uint32_t, std::uint64_t> ids_by_row(const ToyServer& server, const Replica& replica) {
  std::map<std::uint32_t, std::uint64_t> out;
  test::for_each_held(server, replica, [&](std::uint64_t id, std::uint32_t row) { out[row] = id; });
  return out;
}

std::set<std::uint64_t> ids_of(const std::map<std::uint32_t, std::uint64_t>& by_row) {
  std::set<std::uint64_t> out;
  for (const auto& [row, id] : by_row) out.insert(id);
  return out;
}

// Of one page: between two Gaussians go over as if they left and arrived.
TEST(GpuRowsTurnover, WhatArrivesAndLeavesIsToldFromWhatMoves) {
  ToyServer server(21, 700);
  Replica replica;
  GpuRows gpu(replica);
  test::join(server.stream, replica);
  std::vector<std::uint32_t> rows;
  std::vector<GpuRecord> records;
  GpuRows::Turnover turnover;
  gpu.take_records(100'000, rows, records, nullptr, &turnover);
  EXPECT_EQ(std::ranges::count(turnover.origins, GpuRows::kNoRow), std::ssize(rows)) << "all have arrived";
  std::size_t arrived = 0, left = 0, moved = 0;
  for (int turn = 0; turn < 30; ++turn) {
    const auto before = ids_by_row(server, replica);
    const int ticks = 1 + turn % 3;  // that nobody has taken in between
    for (int k = 0; k < ticks; ++k) {
      server.train(0.01F);
      if ((turn + k) % 3 == 0) server.remove(60);
      if ((turn + k) % 3 == 1) server.insert(60);
      server.tick_for(replica);
    }
    const auto after = ids_by_row(server, replica);
    const std::set<std::uint64_t> were = ids_of(before), are = ids_of(after);
    gpu.take_records(100'000, rows, records, nullptr, &turnover);
    ASSERT_EQ(turnover.origins.size(), rows.size());
    ASSERT_EQ(turnover.left.size(), rows.size());
    for (std::size_t i = 0; i < rows.size(); ++i) {
      const auto was = before.find(rows[i]), is = after.find(rows[i]);
      const std::uint32_t origin = turnover.origins[i];
      if (is != after.end()) {
        const bool arrives = !were.contains(is->second);
        EXPECT_EQ(origin == GpuRows::kNoRow, arrives) << "row " << rows[i];
        if (origin != GpuRows::kNoRow) {
          EXPECT_EQ(before.at(origin), is->second) << "row " << rows[i];
        }
        arrived += arrives ? 1 : 0;
        moved += !arrives && origin != rows[i] ? 1 : 0;
      }
      if (was == before.end()) continue;
      const bool leaves = !are.contains(was->second);
      EXPECT_EQ(turnover.left[i] != 0, leaves) << "row " << rows[i];
      left += leaves ? 1 : 0;
    }
    if (testing::Test::HasFailure()) FAIL() << "turn " << turn;
  }
  EXPECT_GT(arrived, 500U);
  EXPECT_GT(left, 500U);
  EXPECT_GT(moved, 300U);
}

}  // namespace
}  // namespace splatbus::stream

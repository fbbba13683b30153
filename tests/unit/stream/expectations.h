#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <map>

#include "shown_replica.h"
#include "stream/stream_model.h"

namespace splatbus::stream::test {

/// Page by page, lane by lane; rows and ids are everybody's own.
inline void expect_exact(const StreamModel& server, const Replica& replica) {
  const ReplicatedState &want = server.held(), &got = replica.held();
  EXPECT_TRUE(got.layout == want.layout);
  ASSERT_EQ(got.pages.size(), want.pages.size());
  for (const auto& [number, page] : want.pages) {
    const HeldPage* held = got.find(number);
    ASSERT_TRUE(held) << "page " << number;
    ASSERT_TRUE(held->whole());
    ASSERT_EQ(held->version, page.version) << "page " << number;
    ASSERT_EQ(held->structure, page.structure) << "page " << number;
    ASSERT_EQ(held->count, page.count);
    QuantizedGaussians lanes = want.lanes(page);
    lanes.gaussian_id.assign(page.count, 0);
    ASSERT_TRUE(got.lanes(*held) == lanes) << "page " << number << ": server's mirror and replica differ";
    for (const auto& [id, row] : want.light_rows.all()) {
      const Bytes* other = got.light_rows.find(id);
      ASSERT_TRUE(other);
      for (std::uint32_t lane = 0; lane < page.count; ++lane) {
        ASSERT_EQ((*other)[held->row(lane)], row[page.row(lane)]) << "light " << id;
      }
    }
  }
  EXPECT_EQ(replica.count(), want.count);
}

/// Rows between the Gaussians of a range are transparent.
inline bool is_shown(const GaussiansView& gaussians, std::uint32_t row) {
  return *gaussians.at(ParameterLayout::kOpacityLogit, row) > -100;
}
inline std::size_t count_shown(const GaussiansView& gaussians) {
  std::size_t count = 0;
  for (const IndexRange& range : gaussians.ranges) {
    for (std::uint32_t k = 0; k < range.count; ++k) count += is_shown(gaussians, range.first + k) ? 1 : 0;
  }
  return count;
}

/// The floats that are shown equal those made afresh from the integers, row by row.
inline void expect_shown(ShownReplica& replica) {
  DisplayGaussians fresh;
  fresh.apply(replica.whole());
  const GaussiansView want = fresh.view(), got = replica.view();
  ASSERT_TRUE(std::ranges::equal(got.ranges, want.ranges));
  ASSERT_EQ(got.visibility_u8 != nullptr, want.visibility_u8 != nullptr);
  ASSERT_EQ(got.visibility_rows, want.visibility_rows);
  for (const IndexRange& range : want.ranges) {
    for (std::uint32_t i = range.first; i < range.first + range.count; ++i) {
      ASSERT_EQ(is_shown(got, i), is_shown(want, i)) << i;
      if (!is_shown(want, i)) continue;
      for (int c = 0; c < want.layout.channels(); ++c) ASSERT_EQ(*got.at(c, i), *want.at(c, i)) << "channel " << c;
      ASSERT_EQ(got.object_id[i], want.object_id[i]);
      if (want.visibility != nullptr) {
        ASSERT_EQ(got.visibility[i], want.visibility[i]);
      }
      for (std::uint32_t row = 0; want.visibility_u8 != nullptr && row < want.visibility_rows; ++row) {
        ASSERT_EQ(got.visibility_u8[row * got.visibility_stride + i],
                  want.visibility_u8[row * want.visibility_stride + i]);
      }
    }
  }
}

}  // namespace splatbus::stream::test

#pragma once

#include <gtest/gtest.h>

#include <algorithm>

#include "shown_replica.h"
#include "stream/stream_model.h"

namespace splatbus::stream::test {

inline void expect_exact(const StreamModel& server, const Replica& replica) {
  ASSERT_TRUE(replica.held());
  EXPECT_EQ(replica.held()->sequence, server.held().sequence);
  EXPECT_TRUE(replica.held()->gaussians == server.held().gaussians) << "server's mirror and replica differ";
  EXPECT_TRUE(replica.held()->light_rows == server.held().light_rows) << "server's mirror and replica differ";
  EXPECT_TRUE(replica.held()->layout == server.held().layout);
  EXPECT_EQ(replica.count(), server.held().gaussians.count());
}

/// The floats that are shown equal those made afresh from the integers.
inline void expect_shown(ShownReplica& replica) {
  DisplayGaussians fresh;
  fresh.apply(replica.whole());
  const GaussiansView want = fresh.view(), got = replica.view();
  ASSERT_EQ(got.count, want.count);
  for (int c = 0; c < want.layout.channels(); ++c) {
    ASSERT_TRUE(std::equal(want.plane(c), want.plane(c) + want.count, got.plane(c))) << "channel " << c;
  }
  if (want.visibility != nullptr) {
    ASSERT_TRUE(std::equal(want.visibility, want.visibility + want.count, got.visibility));
  }
  ASSERT_EQ(got.visibility_u8 != nullptr, want.visibility_u8 != nullptr);
  for (std::uint32_t row = 0; want.visibility_u8 != nullptr && row < want.visibility_rows; ++row) {
    const std::uint8_t *a = want.visibility_u8 + row * want.visibility_stride,
                       *b = got.visibility_u8 + row * got.visibility_stride;
    ASSERT_EQ(got.visibility_rows, want.visibility_rows);
    ASSERT_TRUE(std::equal(a, a + want.count, b)) << "row " << row;
  }
  ASSERT_TRUE(std::equal(want.object_id, want.object_id + want.count, got.object_id));
}

}  // namespace splatbus::stream::test

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
  ASSERT_TRUE(std::equal(want.object_id, want.object_id + want.count, got.object_id));
}

}  // namespace splatbus::stream::test

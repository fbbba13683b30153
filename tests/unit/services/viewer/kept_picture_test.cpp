#include "viewer/ui/kept_picture.h"

#include <gtest/gtest.h>

#include "gl/context.h"

namespace splatbus::viewer {
namespace {

TEST(KeptPicture, OfAWindowWithoutPixelsIsTheOneBefore) {
  GlContext context;
  KeptPicture kept;
  kept.keep(0, 0);
  EXPECT_TRUE(kept.read().empty());
  kept.keep(6, 4);
  kept.keep(0, 0);
  EXPECT_EQ(kept.read().size(), cv::Size(6, 4));
}

}  // namespace
}  // namespace splatbus::viewer

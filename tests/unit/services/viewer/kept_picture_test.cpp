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

TEST(KeptPicture, OfAnotherContextIsShownAsItWas) {
  GlContext context;
  cv::Mat picture(4, 7, CV_8UC3, cv::Scalar(10, 200, 30));
  picture.row(0).setTo(cv::Scalar(250, 1, 2));  // the uppermost
  KeptPicture kept;
  kept.keep(6, 4);
  kept.put(picture);
  EXPECT_EQ(cv::norm(kept.read(), picture, cv::NORM_INF), 0);
}

}  // namespace
}  // namespace splatbus::viewer

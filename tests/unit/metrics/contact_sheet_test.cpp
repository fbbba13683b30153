#include "metrics/contact_sheet.h"

#include <gtest/gtest.h>

#include <cstdlib>
#include <opencv2/imgproc.hpp>
#include <stdexcept>

#include "metrics/image_io.h"
#include "metrics/metrics.h"
#include "pictures.h"

namespace splatbus::metrics {
namespace {

ContactSheet example() {
  ContactSheet sheet;
  sheet.title = "splatbus demo, 60 s";
  sheet.columns = {"engine", "server", "viewer", "FLIP of viewer"};
  sheet.picture_height = 144;
  cv::Mat map;
  (void)flip(test::shift(), test::reference(), 67.0, &map);
  for (int i = 0; i < 3; ++i) {
    sheet.rows.push_back({"camera " + std::to_string(i + 1),
                          {"server SSIM 0.971", "server PSNR 31.2 dB", "viewer SSIM 0.969"},
                          {test::reference(), test::noise(), test::shift(), colorize(map)}});
  }
  return sheet;
}

/// Whether `part` of the canvas holds anything but one colour.
bool has_content(const cv::Mat& canvas, const cv::Rect& part) {
  cv::Scalar mean, deviation;
  cv::meanStdDev(canvas(part), mean, deviation);
  return deviation[0] + deviation[1] + deviation[2] > 1;
}

TEST(ContactSheet, ShowsEveryPictureUnharmed) {
  const cv::Mat canvas = draw(example());
  ASSERT_EQ(canvas.type(), CV_8UC3);
  for (const cv::Mat& picture : {test::reference(), test::noise(), test::shift()}) {
    cv::Mat enlarged, score;
    cv::resize(picture, enlarged, {}, 2, 2, cv::INTER_NEAREST);
    cv::matchTemplate(canvas, enlarged, score, cv::TM_SQDIFF);
    double best = 0;
    cv::minMaxLoc(score, &best);
    EXPECT_LT(best, 1e-6 * cv::norm(enlarged, cv::NORM_L2SQR));
  }
  if (const char* path = std::getenv("SPLATBUS_TEST_CONTACT_SHEET")) write_png(path, canvas);  // for the eye
}

TEST(ContactSheet, HasTitleAndCaptionsAndAnEmptyMargin) {
  const cv::Mat canvas = draw(example());
  EXPECT_TRUE(has_content(canvas, {0, 0, canvas.cols, 44}));
  EXPECT_TRUE(has_content(canvas, {24, 100, 100, 100}));
  EXPECT_FALSE(has_content(canvas, {0, 0, 20, canvas.rows}));
  EXPECT_FALSE(has_content(canvas, {canvas.cols - 20, 0, 20, canvas.rows}));
  EXPECT_FALSE(has_content(canvas, {0, canvas.rows - 20, canvas.cols, 20}));
}

TEST(ContactSheet, LeavesThePlaceOfAMissingPictureBlank) {
  ContactSheet sheet;
  sheet.columns = {"a", "b"};
  sheet.rows.push_back({"", {}, {cv::Mat(), cv::Mat(40, 40, CV_8UC3, cv::Scalar(0, 0, 255))}});
  EXPECT_NO_THROW((void)draw(sheet));
  sheet.rows[0].pictures.pop_back();
  EXPECT_NO_THROW((void)draw(sheet));
}

TEST(ContactSheet, RefusesWhatItCannotShow) {
  EXPECT_THROW((void)draw(ContactSheet{}), std::invalid_argument);
  ContactSheet sheet = example();
  sheet.rows[1].pictures.emplace_back(8, 8, CV_8UC3);
  EXPECT_THROW((void)draw(sheet), std::invalid_argument);
  sheet = example();
  sheet.rows[0].pictures[0] = cv::Mat(8, 8, CV_32FC3);
  EXPECT_THROW((void)draw(sheet), std::invalid_argument);
}

}  // namespace
}  // namespace splatbus::metrics

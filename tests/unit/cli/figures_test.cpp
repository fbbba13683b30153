#include "figures.h"

#include <gtest/gtest.h>

#include <limits>

namespace splatbus::cli {
namespace {

const ViewFigures kViewFigures{{0, {.psnr_db = 30, .ssim = 0.9, .flip = 0.02}},
                               {1, {.psnr_db = std::numeric_limits<double>::infinity(), .ssim = 0.98, .flip = 0.04}}};

TEST(Figures, MeansAndExtremes) {
  const FigureSummary summary = summarize(kViewFigures);
  EXPECT_NEAR(summary.mean.ssim, 0.94, 1e-12);
  EXPECT_NEAR(summary.mean.psnr_db, 65, 1e-12) << "equal pictures count as 100 dB";
  EXPECT_NEAR(summary.mean.flip, 0.03, 1e-12);
  EXPECT_DOUBLE_EQ(summary.ssim_min, 0.9);
  EXPECT_DOUBLE_EQ(summary.flip_max, 0.04);
}

TEST(Figures, ARoundIsOfIdsThatFollowOneAnother) {
  ViewFigures all;
  for (const std::size_t id : {256U, 257U, 258U, 259U, 512U, 513U, 768U, 769U, 770U})
    all[id].ssim = static_cast<double>(id);
  const ViewFigures last = last_round(all);
  ASSERT_EQ(last.size(), 3U);
  EXPECT_EQ(last.begin()->first, 768U);
  EXPECT_NEAR(summarize(last).mean.ssim, 769, 1e-9);
  all.erase(769);
  EXPECT_EQ(last_round(all).size(), 2U) << "one was lost";
  all.erase(770);
  EXPECT_EQ(last_round(all).size(), 1U);
  EXPECT_TRUE(last_round({}).empty());
}

TEST(Figures, CsvHasARowAView) {
  EXPECT_EQ(csv_rows(100, 0.25, kViewFigures),
            "100,0,0.90000,30.000,0.02000,0.2500\n100,1,0.98000,100.000,0.04000,0.2500\n");
}

TEST(Figures, RoundedKeepsSixDigits) {
  EXPECT_DOUBLE_EQ(rounded(0.123456789), 0.123457);
  EXPECT_DOUBLE_EQ(rounded(123456789), 123457000);
  EXPECT_DOUBLE_EQ(rounded(std::numeric_limits<double>::quiet_NaN()), 0);
}

TEST(Figures, UnwritableFileIsNamed) {
  try {
    write_text("/nonexistent/file.csv", "x");
    FAIL();
  } catch (const std::runtime_error& error) {
    EXPECT_STREQ(error.what(), "/nonexistent/file.csv: cannot be written");
  }
}

}  // namespace
}  // namespace splatbus::cli

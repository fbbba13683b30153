#include "dynamics_figures.h"

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <vector>

#include "dynamics_evaluation.h"
#include "metrics/image_io.h"

namespace splatbus::cli {
namespace {

const std::vector<TimedFigure> kFigures{{9.9, 0.1}, {10, 0.9},     {10.5, 0.7},   {11.2, 0.95},
                                        {12, 0.75}, {12.99, 0.79}, {14.999, 0.8}, {15, 0.2}};
constexpr TimeWindow kWindow{.from_s = 10, .to_s = 15};

TEST(DynamicsFigures, TheLastFortySecondsAreJudged) {
  EXPECT_DOUBLE_EQ(judged_window(60).from_s, 20);
  EXPECT_DOUBLE_EQ(judged_window(60).to_s, 60);
  EXPECT_DOUBLE_EQ(judged_window(600).from_s, 560);
  EXPECT_DOUBLE_EQ(judged_window(30).from_s, 10) << "of a short run its last two thirds";
}

TEST(DynamicsFigures, MeanWithinCountsOnlyTheWindow) {
  EXPECT_NEAR(*mean_within(kFigures, kWindow), (0.9 + 0.7 + 0.95 + 0.75 + 0.79 + 0.8) / 6, 1e-12);
  EXPECT_FALSE(mean_within(kFigures, {.from_s = 20, .to_s = 30}));
}

TEST(DynamicsFigures, WorstSecondIsALeastMeanNotALeastFigure) {
  // Seconds from 10: (0.9, 0.7), (0.95), (0.75, 0.79), none, (0.8). The least figure, 0.7, is in another second than
  // the least mean, 0.77.
  EXPECT_NEAR(*worst_second(kFigures, kWindow), 0.77, 1e-12);
  // Seconds are the window's: from 9.5 on 0.1 and 0.9 are one.
  EXPECT_NEAR(*worst_second(kFigures, {.from_s = 9.5, .to_s = 12.5}), 0.5, 1e-12);
  EXPECT_FALSE(worst_second(kFigures, {.from_s = 0, .to_s = 5}));
}

TEST(DynamicsFigures, RatesAreInKilobits) {
  EXPECT_NEAR(*kilobits_per_s(1000, 26000, 10), 20, 1e-12);
  EXPECT_FALSE(kilobits_per_s(1000, 26000, 0));
  EXPECT_FALSE(kilobits_per_s(1000, 10, 10)) << "a streamer that began anew";
}

TEST(DynamicsFigures, MaskGrowsRoundTheObjectsAndLeavesTheBorder) {
  cv::Mat ids = cv::Mat::zeros(32, 40, CV_32SC1);
  ids.at<std::int32_t>(16, 20) = 7;
  ids.at<std::int32_t>(10, 10) = 3;                                      // does not move
  ids.at<std::int32_t>(6, 33) = static_cast<std::int32_t>(0xFFFFFFF0U);  // ids have 32 bits
  const cv::Mat mask = grown(mask_of(ids, {7, 0xFFFFFFF0U}), 3);
  for (int row = 0; row < mask.rows; ++row) {
    for (int column = 0; column < mask.cols; ++column) {
      const bool near_seven = std::abs(row - 16) <= 3 && std::abs(column - 20) <= 3;
      const bool near_large = std::abs(row - 6) <= 3 && std::abs(column - 33) <= 3;
      const bool inside = row >= 5 && row < 32 - 5 && column >= 5 && column < 40 - 5;
      EXPECT_EQ(mask.at<std::uint8_t>(row, column) != 0, (near_seven || near_large) && inside) << row << ", " << column;
    }
  }
}

TEST(DynamicsFigures, PsnrCountsTheMaskAlone) {
  const cv::Mat reference(12, 12, CV_8UC3, cv::Scalar(100, 100, 100));
  cv::Mat picture = reference.clone();
  cv::Mat mask = cv::Mat::zeros(12, 12, CV_8UC1);
  mask(cv::Rect(0, 0, 4, 12)).setTo(255);
  picture(cv::Rect(0, 0, 2, 12)).setTo(cv::Scalar(110, 100, 90));  // half of it, 10 off in two of three channels
  picture(cv::Rect(8, 0, 4, 12)).setTo(cv::Scalar(0, 0, 0));
  EXPECT_NEAR(*masked_psnr(picture, reference, mask), 10 * std::log10(255 * 255 / (100.0 * 2 / 3 / 2)), 1e-4);
  EXPECT_FALSE(masked_psnr(picture, reference, cv::Mat::zeros(12, 12, CV_8UC1)));
}

TEST(DynamicsFigures, AReturnIsJudgedByTheFirstPictureAfterIt) {
  const std::vector<ObjectFigures> seen{
      {.existing = {4, 7}, .of_object = {{4, 0.9}, {7, 0.8}}},
      {.existing = {4, 7}, .of_object = {{4, 0.95}}},  // 7 is hidden: it has not gone
      {.existing = {7}, .of_object = {{7, 0.7}}},
      {.existing = {4, 7}, .of_object = {{7, 0.75}}},  // 4 is there, behind something
      {.existing = {4, 7, 9}, .of_object = {{4, 0.85}, {9, 0.1}}},
      {.existing = {4, 7, 9}, .of_object = {{4, 0.2}, {9, 0.2}}},
  };
  const std::vector<double> drops = return_drops(seen);
  ASSERT_EQ(drops.size(), 1U);
  EXPECT_NEAR(drops[0], 0.95 - 0.85, 1e-12);
}

TEST(DynamicsFigures, MotionResidualIsWhatOnlyOneOfThemChanges) {
  const auto picture = [](std::uint8_t left, std::uint8_t right) {
    cv::Mat of_two(1, 2, CV_8UC3);
    of_two.at<cv::Vec3b>(0, 0) = cv::Vec3b::all(left);
    of_two.at<cv::Vec3b>(0, 1) = cv::Vec3b::all(right);
    return of_two;
  };
  // On the left both darken by 30, one of them from a wrong level; on the right the drawn one pops by 200.
  const cv::Mat residual = motion_residual(picture(100, 50), picture(70, 50), picture(40, 220), picture(10, 20));
  EXPECT_EQ(residual.at<cv::Vec3b>(0, 0), cv::Vec3b::all(0));
  EXPECT_EQ(residual.at<cv::Vec3b>(0, 1), cv::Vec3b::all(200));
}

TEST(DynamicsFigures, MaskedMeanIsOfTheMaskAlone) {
  const cv::Mat map = (cv::Mat_<float>(2, 3) << 0.5F, 0.25F, 1, 0.75F, 0, 0.125F);
  const cv::Mat mask = (cv::Mat_<std::uint8_t>(2, 3) << 255, 0, 0, 255, 1, 0);
  EXPECT_NEAR(*masked_mean(map, mask), (0.5 + 0.75 + 0) / 3, 1e-7);
  EXPECT_FALSE(masked_mean(map, cv::Mat::zeros(2, 3, CV_8UC1)));
}

TEST(DynamicsFigures, MeanMapIsTheMeanOfEachPixel) {
  MeanMap maps;
  EXPECT_TRUE(maps.mean().empty());
  maps.add((cv::Mat_<float>(1, 2) << 0.5F, 1));
  maps.add((cv::Mat_<float>(1, 2) << 0.25F, 0));
  maps.add((cv::Mat_<float>(1, 2) << 0, 0.5F));
  EXPECT_FLOAT_EQ(maps.mean().at<float>(0, 0), 0.25F);
  EXPECT_FLOAT_EQ(maps.mean().at<float>(0, 1), 0.5F);
}

DynamicsSample sample(double time_s, double on, double off) {
  return {.time_s = time_s,
          .paired = true,
          .on = DrawnFigures{.whole = {.psnr_db = 30, .ssim = on, .flip = 1 - on},
                             .masked = {.moving = on - 0.1, .shadow = on - 0.2}},
          .off = DrawnFigures{.whole = {.psnr_db = 20, .ssim = off, .flip = 1 - off}, .masked = {}},
          .viewer = {},
          .still = {}};
}

ObjectTransforms objects(std::initializer_list<std::uint32_t> ids) {
  ObjectTransforms transforms;
  for (const std::uint32_t id : ids) transforms[id] = {};
  return transforms;
}

TEST(GhostMasks, ShowWhereAnObjectWasFromTwoToFourSecondsAfterItVanished) {
  cv::Mat with = cv::Mat::zeros(32, 32, CV_32SC1);
  with(cv::Rect(10, 10, 8, 8)) = 7;
  with(cv::Rect(24, 24, 2, 2)) = 5;
  cv::Mat without = with.clone();
  without(cv::Rect(10, 10, 8, 8)) = 0;
  GhostMasks ghosts(2, 4);
  EXPECT_TRUE(ghosts.take(0, 1, objects({5, 7}), with).empty());
  EXPECT_TRUE(ghosts.take(0, 1.5, objects({5}), without).empty()) << "it has only just gone";
  EXPECT_TRUE(ghosts.take(1, 4, objects({5}), without).empty()) << "another camera never saw it";
  const cv::Mat mask = ghosts.take(0, 3.6, objects({5}), without);
  ASSERT_FALSE(mask.empty());
  EXPECT_EQ(cv::countNonZero(mask), 64);
  EXPECT_EQ(cv::countNonZero(mask(cv::Rect(10, 10, 8, 8))), 64);
  cv::Mat covered = without.clone();
  covered(cv::Rect(0, 10, 10, 8)) = 5;
  EXPECT_EQ(cv::countNonZero(ghosts.take(0, 4, objects({5}), covered)), 24) << "beside what moves now";
  EXPECT_TRUE(ghosts.take(0, 5.6, objects({5}), without).empty()) << "4 s are over";
}

TEST(GhostMasks, OthersAreJudgedLater) {
  const cv::Mat ids(32, 32, CV_32SC1, cv::Scalar(7)), nothing = cv::Mat::zeros(32, 32, CV_32SC1);
  GhostMasks settled(15, 25);
  EXPECT_TRUE(settled.take(0, 0, objects({7}), ids).empty());
  EXPECT_TRUE(settled.take(0, 1, objects({}), nothing).empty());
  EXPECT_TRUE(settled.take(0, 10, objects({}), nothing).empty());
  EXPECT_FALSE(settled.take(0, 17, objects({}), nothing).empty());
  EXPECT_TRUE(settled.take(0, 27, objects({}), nothing).empty());
}

TEST(GhostMasks, AnObjectThatReturnsLeavesNone) {
  const cv::Mat ids(32, 32, CV_32SC1, cv::Scalar(7)), nothing = cv::Mat::zeros(32, 32, CV_32SC1);
  GhostMasks ghosts(2, 4);
  EXPECT_TRUE(ghosts.take(0, 0, objects({7}), ids).empty());
  EXPECT_TRUE(ghosts.take(0, 1, objects({}), nothing).empty());
  EXPECT_TRUE(ghosts.take(0, 2, objects({7}), ids).empty());
  EXPECT_TRUE(ghosts.take(0, 3.5, objects({7}), ids).empty());
}

TEST(DynamicsFigures, SummaryHasEachFigureOfItsOwnRunAndWindow) {
  DynamicsResults still, living;
  still.window = {.from_s = 10, .to_s = 40};
  still.samples = {sample(5, 0, 0), sample(11, 0.98, 0), sample(12, 0.96, 0)};
  living.window = {.from_s = 20, .to_s = 60};
  living.samples = {sample(10, 0.2, 0.1), sample(20, 0.9, 0.5), sample(21, 0.94, 0.7)};
  living.samples[1].still = {.moving = 0.83, .shadow = {}};  // 0.03 above its 0.8
  living.samples[2].still = {.moving = {}, .shadow = 0.75};  // 0.01 above its 0.74
  living.samples[2].viewer =
      DrawnFigures{.whole = {.psnr_db = 30, .ssim = 0.91, .flip = 0.1}, .masked = {.moving = 0.5, .shadow = 0.71}};
  living.samples[1].on->ghost_flip = 0.07;
  living.samples[1].still_ghost_flip = 0.05;
  living.samples[2].on->ghost_flip = 0.5;
  living.samples.push_back(sample(61, 0.5, 0.5));
  // Drawn with another instant's visibility: it is the viewer's picture that counts.
  living.samples.push_back(sample(22, 0.1, 0.1));
  living.samples.back().paired = false;
  living.samples.back().viewer = DrawnFigures{
      .whole = {.psnr_db = 30, .ssim = 0.89, .flip = 0.3}, .masked = {.moving = 0.7, .shadow = {}}, .ghost_flip = 0.09};
  living.samples.back().still = {.moving = 0.75, .shadow = {}};
  living.samples.back().still_ghost_flip = 0.05;
  living.state_delay_ms_median = 12;
  living.scene_kbps = 55;
  nlohmann::json summary = summarize_still(still);
  summary.update(summarize_living(living));
  EXPECT_NEAR(summary["still_ssim"], 0.97, 1e-6);
  EXPECT_NEAR(summary["on_ssim"], 0.92, 1e-6);
  EXPECT_NEAR(summary["on_flip"], 0.08, 1e-6);
  EXPECT_NEAR(summary["off_ssim"], 0.6, 1e-6);
  EXPECT_NEAR(summary["on_ssim_worst_second"], 0.9, 1e-6);
  EXPECT_NEAR(summary["masked_ssim"], 0.82, 1e-6);
  EXPECT_NEAR(summary["masked_ssim_drop"], 0.03, 1e-6) << "only of pictures that have both";
  EXPECT_NEAR(summary["shadow_ssim"], 0.72, 1e-6);
  EXPECT_NEAR(summary["shadow_ssim_drop"], 0.01, 1e-6);
  EXPECT_TRUE(summary["shadow_ssim_off"].is_null());
  EXPECT_NEAR(summary["ssim_viewer"], 0.90, 1e-6);
  EXPECT_NEAR(summary["ssim_viewer_worst_second"], 0.89, 1e-6);
  EXPECT_NEAR(summary["flip_viewer"], 0.2, 1e-6);
  EXPECT_NEAR(summary["masked_ssim_viewer"], 0.6, 1e-6);
  EXPECT_NEAR(summary["masked_ssim_drop_viewer"], 0.05, 1e-6) << "only of pictures that have both";
  EXPECT_NEAR(summary["shadow_ssim_drop_viewer"], 0.04, 1e-6);
  EXPECT_NEAR(summary["ghost_flip_viewer"], 0.09, 1e-6);
  EXPECT_EQ(summary["state_delay_ms_median"], 12);
  EXPECT_TRUE(summary["state_delay_ms_p99"].is_null());
  EXPECT_EQ(summary["scene_kbps"], 55);
  EXPECT_TRUE(summary["visibility_kbps"].is_null());
  EXPECT_EQ(summary["pictures"], 5);
  EXPECT_EQ(summary["pictures_paired"], 4);
  EXPECT_NEAR(summary["ghost_flip"], 0.07, 1e-6) << "only of pictures that have both";
  EXPECT_NEAR(summary["ghost_flip_still"], 0.05, 1e-6);
  ASSERT_EQ(summary["on_ssim_by_minute"].size(), 2U);
  EXPECT_NEAR(summary["on_ssim_by_minute"][0], (0.2 + 0.9 + 0.94) / 3, 1e-6) << "of the whole run";
  EXPECT_NEAR(summary["on_ssim_by_minute"][1], 0.5, 1e-6);
}

/// Of a scene in which object 7 moves at the left; the engine shows it red.
TEST(DynamicsShots, TheViewersOwnPictureIsJudgedInTheSameMasks) {
  const auto folder = std::filesystem::temp_directory_path() / fmt::format("dynamics_shots_{}", getpid());
  std::filesystem::create_directories(folder);
  cv::Mat ids = cv::Mat::zeros(64, 64, CV_32SC1);
  ids(cv::Rect(16, 24, 12, 12)) = 7;
  cv::Mat engine(64, 64, CV_8UC3, cv::Scalar(90, 90, 90));
  engine(cv::Rect(16, 24, 12, 12)) = cv::Scalar(20, 20, 200);
  cv::Mat misses_it(64, 64, CV_8UC3, cv::Scalar(90, 90, 90));
  ProbePicture probe;
  probe.time_s = 5;
  probe.picture = engine;
  probe.object_id = ids;
  probe.scene.objects = objects({7});
  metrics::write_png(folder / "probe_11_viewer.png", misses_it);
  DynamicsShots shots({.from_s = 0, .to_s = 10}, nullptr, folder);
  std::vector<DynamicsSample> samples(2);
  for (std::size_t k = 0; k < 2; ++k) {
    samples[k].probe_id = probe.probe_id = 11 + k;
    samples[k].time_s = 5;
    shots.add(k, 0, probe, nullptr, {.engine = engine, .on = engine, .off = {}});
  }
  shots.compare(samples, 1);
  EXPECT_FALSE(samples[1].on) << "it is kept";
  ASSERT_TRUE(samples[0].on && samples[0].viewer);
  EXPECT_NEAR(*samples[0].on->masked.moving, 1, 1e-6);
  EXPECT_LT(*samples[0].viewer->masked.moving, 0.8);
  EXPECT_GT(samples[0].viewer->whole.ssim, *samples[0].viewer->masked.moving);
  shots.compare(samples, 0);
  EXPECT_TRUE(samples[1].on);
  EXPECT_FALSE(samples[1].viewer) << "it has written none";
  std::filesystem::remove_all(folder);
}

}  // namespace
}  // namespace splatbus::cli

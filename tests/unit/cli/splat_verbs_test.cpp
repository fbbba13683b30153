#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "../gaussians/random.h"
#include "metrics/image_io.h"
#include "run_verb.h"
#include "splats/file.h"

namespace splatbus::cli {
namespace {

using ::testing::HasSubstr;
using ::testing::ThrowsMessage;

/// Red above, green to the right, for who looks along -z; our axes.
class SplatVerbs : public testing::Test {
 protected:
  void SetUp() override {
    GaussiansBuffer model({Appearance::Radiance, 0}, 2);
    splats::Splat splat;
    splat.log_scale = glm::vec3(std::log(0.1F));
    splat.opacity_logit = 6;
    splat.mean = {0, 1, 0};
    splat.sh[0] = glm::vec3(0.5F, -0.5F, -0.5F) / kShC0;
    splats::store(splat, model, 0);
    splat.mean = {1, 0, 0};
    splat.sh[0] = glm::vec3(-0.5F, 0.5F, -0.5F) / kShC0;
    splats::store(splat, model, 1);
    splats::write_file(path_, model.view(), {});
  }

  /// As the file's reader has it who stands on +z.
  cv::Mat picture(const std::string& file, std::vector<std::string> more = {}) {
    const std::string png = folder_.file("picture.png");
    std::vector<std::string> arguments = {"view", file,        "--out", png,     "--width", "64",       "--height",
                                          "64",   "--backend", "cpu",   "--eye", "0,0,4",   "--target", "0,0,0"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    run_verb(add_view_verb, arguments);
    return metrics::read_png(png);
  }

  /// Pixels from the middle to a metre away: 32 / tan(30 degrees) / 4.
  static constexpr int kMetre_px = 14;
  static int red(const cv::Mat& image, int x, int y) { return image.at<cv::Vec3b>(y, x)[2]; }
  static int green(const cv::Mat& image, int x, int y) { return image.at<cv::Vec3b>(y, x)[1]; }

  test::TemporaryFolder folder_;
  std::string path_ = folder_.file("model.ply");
};

TEST_F(SplatVerbs, ViewShowsAFileTheRightWayUp) {
  const cv::Mat upright = picture(path_);
  EXPECT_GT(red(upright, 32, 32 - kMetre_px), 150);
  EXPECT_GT(green(upright, 32 + kMetre_px, 32), 150);
  EXPECT_EQ(red(upright, 32, 32 + kMetre_px), 0);
  const cv::Mat turned = picture(path_, {"--axes", "keep"});
  EXPECT_GT(red(turned, 32, 32 + kMetre_px), 150);
  EXPECT_GT(green(turned, 32 - kMetre_px, 32), 150);
}

TEST_F(SplatVerbs, ExportConvertsFiles) {
  const std::string spz = folder_.file("model.spz"), kept = folder_.file("kept.ply");
  EXPECT_THAT(run_verb(add_export_verb, {"export", spz, "--from", path_, "--json"}), HasSubstr(R"("gaussians":2)"));
  EXPECT_GT(red(picture(spz), 32, 32 - kMetre_px), 150);
  run_verb(add_export_verb, {"export", kept, "--from", spz, "--axes", "keep"});
  EXPECT_GT(red(picture(kept), 32, 32 - kMetre_px), 150);
  std::ifstream file(kept);
  EXPECT_THAT(std::string(std::istreambuf_iterator<char>(file), {}), HasSubstr("comment SplatAxes: y-up\n"));
  run_verb(add_export_verb, {"export", spz, "--from", path_, "--spz-version", "3"});
  EXPECT_EQ(std::ifstream(spz).get(), 0x1F);
}

TEST_F(SplatVerbs, ViewFindsAViewOfItsOwn) {
  const std::string png = folder_.file("picture.png");
  run_verb(add_view_verb, {"view", path_, "--out", png, "--width", "64", "--height", "64", "--backend", "cpu"});
  const cv::Mat image = metrics::read_png(png);
  EXPECT_GT(cv::norm(image, cv::NORM_INF), 150) << "something is seen";
}

TEST_F(SplatVerbs, WrongNamesAreRefusedBeforeAnybodyWaits) {
  EXPECT_THAT(
      [&] {
        run_verb(add_export_verb, {"export", "model.obj", "--timeout", "1000"});
      },
      ThrowsMessage<std::runtime_error>(HasSubstr("model.obj: .ply, .glb and .spz can be written")));
  EXPECT_THAT(
      [&] {
        run_verb(add_view_verb, {"view", "/no/such.ply", "--out", "x.png"});
      },
      ThrowsMessage<std::runtime_error>(HasSubstr("/no/such.ply: cannot be opened")));
}

}  // namespace
}  // namespace splatbus::cli

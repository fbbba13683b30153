// What a picture's surfaces hide, against what the rasteriser draws of each Gaussian alone.
#include "gaussians/occlusion.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "scenes.h"

namespace splatbus::raster {
namespace {

using testing::TestScene;

constexpr std::uint32_t kWidth = 90, kHeight = 58;  // neither a whole number of squares
constexpr float kWall_m = 2.5F;

/// A wall at the left with a slit of sky down it and perhaps one across its foot, a floor that comes nearer downwards
/// at the right, and sky above.
std::vector<float> street(bool slit_across) {
  std::vector<float> depth_m(std::size_t{kWidth} * kHeight);
  for (std::uint32_t row = 0; row < kHeight; ++row) {
    for (std::uint32_t column = 0; column < kWidth; ++column) {
      float& depth = depth_m[std::size_t{row} * kWidth + column];
      if (column < 50) depth = column == 20 || (slit_across && row == 44) ? 0.0F : kWall_m;
      if (column >= 50) depth = row < 20 ? 0.0F : 60.0F / static_cast<float>(row);
    }
  }
  return depth_m;
}

std::vector<float> farthest(const std::vector<float>& depth_m) {
  constexpr std::uint32_t kColumns = 12, kRows = 8;
  std::vector<float> squares(std::size_t{kColumns} * kRows, 0.0F);
  for (std::uint32_t row = 0; row < kHeight; ++row) {
    for (std::uint32_t column = 0; column < kWidth; ++column) {
      const float depth = depth_m[std::size_t{row} * kWidth + column];
      for (std::uint32_t r = (row > 0 ? row - 1 : 0) / 8; r <= std::min((row + 1) / 8, kRows - 1); ++r) {
        for (std::uint32_t c = (column > 0 ? column - 1 : 0) / 8; c <= std::min((column + 1) / 8, kColumns - 1); ++c) {
          float& most = squares[std::size_t{r} * kColumns + c];
          most = std::max(most, depth > 0 ? depth : INFINITY);
        }
      }
    }
  }
  return squares;
}

/// Each Gaussian of a random scene by itself, in a frame of that scale.
class Hidden : public ::testing::TestWithParam<float> {
 protected:
  Hidden() {
    scene_.state.objects[3] = Rigid{glm::normalize(glm::quat(0.8F, 0.3F, -0.4F, 0.2F)), {0.2F, -0.1F, 0.3F}};
    scene_.state.objects[3].scale = GetParam();
  }

  [[nodiscard]] TestScene single(std::size_t i, std::uint32_t frame_id) {
    TestScene one(scene_.layout, 1);
    one.object_id[0] = frame_id;
    one.state = scene_.state;
    for (int c = 0; c < scene_.layout.channels(); ++c) one.at(c, 0) = scene_.at(c, i);
    for (int c = 0; c < 3; ++c) {  // as far about the camera, and as large, as at a scale of 1
      one.at(ParameterLayout::kMean + c, 0) /= GetParam();
      one.at(ParameterLayout::kLogScale + c, 0) -= std::log(GetParam());
    }
    return one;
  }

  [[nodiscard]] Render drawn(const TestScene& one) const {
    Render picture;
    rasterizer_->render(one.view(), camera_, one.state, {}, picture);
    return picture;
  }

  [[nodiscard]] bool selected(const TestScene& one, const FarthestSurfaces& surfaces) const {
    GaussiansView view = one.view();
    const std::vector<IndexRange> range{{0, 1, one.object_id[0]}};
    const std::vector<PageBounds> bounds{bounds_of(view, range.front())};
    view.ranges = range;
    view.bounds = bounds;
    const float tan_x = 1.3F * 0.5F * kWidth / camera_.fx, tan_y = 1.3F * 0.5F * kHeight / camera_.fy;
    const FrustumCamera pinhole{camera_.fx, camera_.fy,     camera_.cx, camera_.cy, kWidth,
                                kHeight,    camera_.near_m, 0.3F,       tan_x,      tan_y};
    return !select_ranges(view, pinhole, camera_.world_from_camera, one.state.objects, surfaces).empty();
  }

  [[nodiscard]] float depth_of(TestScene& one) const {
    const ObjectTransform& frame = one.state.objects.at(3);
    const glm::vec3 mean(one.at(0, 0), one.at(1, 0), one.at(2, 0));
    return (inverse(camera_.world_from_camera) * (frame.rigid * (frame.scale * mean))).z;
  }

  std::unique_ptr<Rasterizer> rasterizer_ = make_cpu_rasterizer(1);
  Camera camera_ = testing::test_camera(kWidth, kHeight);
  TestScene scene_ = testing::random_scene(
      testing::radiance_layout(0), 3000,
      {.spread = 5, .scale_low = 0.001F, .scale_high = 0.5F, .logit_low = 5, .logit_high = 9, .objects = false}, 12);
};

bool shows(float alpha) {
  return alpha > 0;
}

TEST_P(Hidden, NothingIsLeftOutThatIsNotBehindWhatEachOfItsPixelsShows) {
  for (const bool slit_across : {false, true}) {
    const std::vector<float> depth_m = street(slit_across), squares = farthest(depth_m);
    std::size_t left_out = 0, behind = 0;
    for (std::size_t i = 0; i < scene_.count; ++i) {
      TestScene one = single(i, 3);
      const Render alone = drawn(one);
      if (std::ranges::none_of(alone.alpha.data, shows)) continue;
      ASSERT_TRUE(selected(one, {})) << i;
      const float mean_m = depth_of(one);
      bool hidden = true;
      for (std::size_t pixel = 0; pixel < depth_m.size(); ++pixel) {
        if (shows(alone.alpha.data[pixel])) hidden &= depth_m[pixel] > 0 && depth_m[pixel] < mean_m;
      }
      behind += hidden ? 1 : 0;
      if (selected(one, {squares.data()})) continue;
      ASSERT_TRUE(hidden) << i << (slit_across ? ", beside a slit across" : "");
      ++left_out;
    }
    // It is not so careful that it leaves nothing out, as far as squares of eight pixels have no sky in them.
    EXPECT_GT(behind, 100U);
    EXPECT_GT(left_out, behind / (slit_across ? 20 : 4));
  }
}

TEST_P(Hidden, NobodyHidesTheFarField) {
  const std::vector<float> near_squares(std::size_t{12} * 8, 0.01F);
  scene_.state.objects[kFarFieldFrame] = far_field();
  std::size_t shown = 0, kept = 0;
  for (std::size_t i = 0; i < 400; ++i) {
    TestScene one = single(i, kFarFieldFrame);
    const glm::vec3 away = glm::normalize(glm::vec3(scene_.at(0, i), scene_.at(1, i), scene_.at(2, i)));
    for (int c = 0; c < 3; ++c) one.at(c, 0) = kFarFieldCentre[c] + kFarFieldRadius * away[c];
    shown += selected(one, {}) ? 1 : 0;
    kept += selected(one, {near_squares.data()}) ? 1 : 0;
  }
  EXPECT_GT(shown, 10U);
  EXPECT_EQ(kept, shown);
}

INSTANTIATE_TEST_SUITE_P(Scales, Hidden, ::testing::Values(1.0F, 0.2F, 4.0F));

}  // namespace
}  // namespace splatbus::raster

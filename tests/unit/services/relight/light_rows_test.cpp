// What a change cannot reach is skipped, and what comes out is what computing all of it anew gives.
#include "relight/light_rows.h"

#include <gtest/gtest.h>

#include <cstring>
#include <random>
#include <vector>

#include "ball_scene.h"

namespace splatbus::relight {
namespace {

using test::BallOverFloor;
using test::HostMap;

constexpr std::size_t kRows = ParameterLayout::kLogScale + 3 + 6;  // log scales at their place, then point and normal
constexpr std::uint32_t kOfPage = 300;

/// Three pages: floor, floor, and an object 7; a sun, a lamp and a light without shadow.
class LightRowsTest : public testing::Test {
 protected:
  LightRowsTest() {
    std::mt19937 random(8);
    std::uniform_real_distribution<float> uniform(-1.2F, 1.2F);
    for (std::uint32_t page = 0; page < 3; ++page) {
      for (std::uint32_t i = 0; i < kOfPage; ++i) {
        float* const lane = pages_.data() + page * kRows * kPageLanes + i;
        for (std::size_t c = 0; c < 3; ++c) lane[(ParameterLayout::kLogScale + c) * kPageLanes] = -4.0F;
        lane[(kRows - 6) * kPageLanes] = lane[0] = uniform(random);
        lane[(kRows - 4) * kPageLanes] = lane[2 * kPageLanes] = uniform(random);
        lane[(kRows - 2) * kPageLanes] = 1;
      }
      ranges_.push_back({.first = page * kPageLanes, .count = kOfPage, .frame_id = page == 2 ? 7U : kWorldFrame});
    }
    view_.count = 2 * kPageLanes + kOfPage;
    view_.stride = kPageLanes;
    view_.page_shift = kPageShift;
    view_.page_stride = kRows * kPageLanes;
    view_.ranges = ranges_;
    view_.parameters = pages_.data();
    view_.surface_point = pages_.data() + (kRows - 6) * kPageLanes;
    view_.normal = pages_.data() + (kRows - 3) * kPageLanes;
    take_sun(scene_);
    const glm::vec3 position(0.9F, 1.7F, 0.2F);
    std::vector<LightMaps::Map> faces;
    for (const HostMap& face : scene_.faces(position, 64)) faces.push_back({face.camera, owned(face.depth_m)});
    lights_.push_back({{.id = 4, .kind = LightKind::Point, .position = position}, maps_of(std::move(faces))});
    lights_.push_back({{.id = 9, .casts_shadow = false}, nullptr});
  }

  static std::shared_ptr<const std::byte> owned(const std::vector<float>& values) {
    auto copy = std::make_shared<std::vector<float>>(values);
    return {copy, reinterpret_cast<const std::byte*>(copy->data())};
  }
  std::shared_ptr<const LightMaps> maps_of(std::vector<LightMaps::Map> maps) {
    return std::make_shared<const LightMaps>(LightMaps{.revision = ++revision_, .maps = std::move(maps)});
  }
  void take_sun(const BallOverFloor& scene) {
    const LightDepthMap map = scene.map();
    const std::vector<float> depth(map.depth_m, map.depth_m + std::size_t{map.camera.width} * map.camera.height);
    const LightOfScene sun{scene.sun().source, maps_of({{map.camera, owned(depth)}})};
    lights_.empty() ? lights_.push_back(sun) : void(lights_.front() = sun);
  }

  [[nodiscard]] PagedModel model() const { return {view_, page_generations_, step_}; }

  /// Of the Gaussians alone.
  [[nodiscard]] std::vector<std::uint8_t> values(LightRows& rows) const {
    const std::uint8_t* const visibility = rows.compute(model(), objects_, lights_, options_);
    std::vector<std::uint8_t> out;
    for (std::size_t light = 0; light < lights_.size(); ++light) {
      for (const IndexRange& range : view_.ranges) {
        const std::uint8_t* const first = visibility + light * view_.count + range.first;
        out.insert(out.end(), first, first + range.count);
      }
    }
    return out;
  }

  /// Computes on with what is there, and all anew, which is the same; returns how many pages of a light were computed.
  std::uint64_t computed() {
    const std::uint64_t before = rows_.computed(), skipped = rows_.skipped();
    LightRows anew({});
    EXPECT_EQ(values(rows_), values(anew));
    EXPECT_EQ(rows_.computed() - before + rows_.skipped() - skipped, lights_.size() * view_.ranges.size());
    return rows_.computed() - before;
  }

  BallOverFloor scene_{glm::vec3(0.5F, 1, 0.3F)};
  std::vector<float> pages_ = std::vector<float>(3 * kRows * kPageLanes, 0.0F);
  std::vector<IndexRange> ranges_;
  std::vector<std::uint64_t> page_generations_{2, 2, 2};
  GaussiansView view_;
  ObjectTransforms objects_{{7, Rigid{.translation = {0.2F, 0, 0}}}};
  std::vector<LightOfScene> lights_;
  VisibilityOptions options_;
  std::uint64_t revision_ = 0, step_ = 100;
  LightRows rows_{{}};
};

TEST_F(LightRowsTest, NothingIsComputedWhereNothingChanges) {
  EXPECT_EQ(computed(), 9U);
  EXPECT_EQ(computed(), 0U);
  EXPECT_EQ(computed(), 0U) << "of what was kept itself";
}

TEST_F(LightRowsTest, ALightsOwnRowIsComputedWhenItsMapsOrItsPlaceChange) {
  computed();
  take_sun(BallOverFloor(glm::vec3(-0.4F, 1, 0.2F)));
  EXPECT_EQ(computed(), 3U);
  const Camera camera = lights_[0].maps->maps[0].camera;
  lights_[0].maps = maps_of({{camera, owned(std::vector<float>(std::size_t{camera.width} * camera.height, 1.0F))}});
  EXPECT_EQ(computed(), 3U) << "something stands between it and all";
  lights_[1].source.range_m = 1.9F;
  EXPECT_EQ(computed(), 3U);
  lights_[1].source.intensity = glm::vec3(7);
  EXPECT_EQ(computed(), 0U) << "visibility is a share";
}

TEST_F(LightRowsTest, LightsThatComeAndGoMoveTheOthersRows) {
  computed();
  const LightOfScene lamp = lights_[1];
  lights_.erase(lights_.begin() + 1);
  EXPECT_EQ(computed(), 0U);
  lights_.insert(lights_.begin() + 1, lamp);
  EXPECT_EQ(computed(), 3U) << "its row has gone";
}

TEST_F(LightRowsTest, AnObjectThatMovesTakesItsPagesAlone) {
  computed();
  objects_.at(7).rigid.translation.x = 0.4F;
  EXPECT_EQ(computed(), 3U);
  objects_.at(7).scale = 1.5F;
  EXPECT_EQ(computed(), 3U);
  objects_.clear();
  EXPECT_EQ(computed(), 3U);
}

TEST_F(LightRowsTest, APageWhoseStructureChangesIsComputed) {
  computed();
  pages_[(kRows - 6) * kPageLanes] += 0.5F;  // a Gaussian of page 0 is another one
  page_generations_[0] = 4;
  EXPECT_EQ(computed(), 3U);
  ranges_.pop_back();  // the object's page has gone, and with it the last indices
  page_generations_.pop_back();
  view_.ranges = ranges_;
  view_.count = kPageLanes + kOfPage;
  EXPECT_EQ(computed(), 0U);
  ranges_.push_back({.first = 2 * kPageLanes, .count = kOfPage, .frame_id = 7});
  page_generations_.push_back(6);
  view_.ranges = ranges_;
  view_.count = 2 * kPageLanes + kOfPage;
  EXPECT_EQ(computed(), 3U);
}

TEST_F(LightRowsTest, OtherOptionsAnotherModelAndScalesThatTrainedOnTakeAll) {
  computed();
  options_.softness_m = 0.05F;
  EXPECT_EQ(computed(), 9U);
  rows_.forget();
  EXPECT_EQ(computed(), 9U);
  step_ = 130;
  EXPECT_EQ(computed(), 0U);
  for (std::size_t i = 0; i < kOfPage; ++i) pages_[ParameterLayout::kLogScale * kPageLanes + i] = -2.5F;
  step_ = 134;
  EXPECT_EQ(computed(), 9U) << "a quarter of all steps came after the page was computed";
  EXPECT_EQ(computed(), 0U);
}

}  // namespace
}  // namespace splatbus::relight

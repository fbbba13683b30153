// Which samples become Gaussians, and which Gaussians they become.
#include <cmath>
#include <glm/gtc/constants.hpp>
#include <limits>
#include <map>
#include <tuple>

#include "gaussians/light.h"
#include "insertion_fixture.h"
#include "room_scene.h"

namespace splatbus::expander::test {
namespace {

TEST_P(InsertionTest, InsertsEverySampleOnce) {
  const HostRound round = floor_round(-1, 1);
  EXPECT_EQ(insert(round).size(), round.size());
  EXPECT_EQ(inserter_->modelled().size(), round.size());
  EXPECT_EQ(inserter_->cells().modelled(), result_.cells.size());
  EXPECT_EQ(insert(round).size(), 0U) << "the same round again";
  EXPECT_EQ(insert(floor_round(-1, 1, 0.9F)).size(), 0U) << "the same floor, sampled elsewhere";
  EXPECT_EQ(inserter_->modelled().size(), round.size());
}

TEST_P(InsertionTest, ANewRegionJoinsWithoutGapOrDouble) {
  const HostRound left = floor_round(-1, 0);
  insert(left);
  const HostRound all = floor_round(-1, 1);
  EXPECT_EQ(insert(all).size(), all.size() - left.size());
}

TEST_P(InsertionTest, ACellSeenAtItsBorderIsToppedUp) {
  use_cells_of(1);
  HostRound strip = empty_round();
  for (int z = 0; z < 16; ++z) add_sample(strip, {-0.4F, 0, -0.4F + kSpacing * static_cast<float>(z)});
  EXPECT_EQ(insert(strip).size(), 16U);
  const HostRound whole = floor_round(-0.425F, 0.425F);
  const HostGaussians topped_up = insert(whole);
  EXPECT_EQ(topped_up.size(), whole.size() - 16) << "all but those that are there";
  for (const glm::vec3& mean : topped_up.mean) {
    for (const glm::vec3& there : strip.position) EXPECT_GT(glm::distance(mean, there), 0.75F * kSpacing);
  }
  EXPECT_EQ(insert(whole).size(), 0U);
}

TEST_P(InsertionTest, BothSidesOfAThinSheetAreModelled) {
  HostRound round = empty_round();
  for (int i = 0; i < 8; ++i) add_sample(round, {0.02F * static_cast<float>(i), 0, 0});
  EXPECT_EQ(insert(round).size(), 8U);
  for (auto& normal : round.normal) normal = -normal;
  EXPECT_EQ(insert(round).size(), 8U);
}

TEST_P(InsertionTest, WhatLiesAloneIsNotSeenButSliversBesideASurfaceAre) {
  HostRound round = floor_round(-0.5F, 0.5F);
  const std::size_t floor = round.size();
  add_sample(round, {0.6F, 0, 0});       // in the next cell, which it has for itself
  add_sample(round, {-1.2F, 0, -1.2F});  // far from all
  EXPECT_EQ(insert(round).size(), floor + 1);
}

TEST_P(InsertionTest, WhatIsFarAndSmallForEveryViewerIsLeftForLater) {
  options_.select.reach_m = 1;
  options_.select.min_pixels = 2;
  const auto viewpoint = [](const math::Vec3& position, const math::Vec3& ahead, float focal_px) {
    return Viewpoint{.position = position, .ahead = ahead, .focal_px = focal_px};
  };
  HostRound round = floor_round(-1, 1);
  // Of the four corners, one has a viewer, one will have another, one is large in the picture of a third.
  const std::vector<glm::vec3> about = {{1, 0, 1}, {-1, 0, 1}};
  viewpoints_ = {viewpoint({1, 0, 1}, {1, 0, 1}, 0), viewpoint({-1, 0, 9}, {-1, 0, 1}, 0),
                 viewpoint({1, 30, -1}, {1, 30, -1}, 1200.5F)};
  const auto pays = [&](const glm::vec3& p) {
    const bool large = kSpacing * 1200.5F / glm::distance(p, glm::vec3(1, 30, -1)) >= 2;
    return glm::distance(p, about[0]) <= 1 || glm::distance(p, about[1]) <= 1 || large;
  };
  std::vector<glm::vec3> expected;
  std::copy_if(round.position.begin(), round.position.end(), std::back_inserter(expected), pays);
  ASSERT_GT(expected.size(), 700U);
  ASSERT_LT(expected.size(), 1500U);
  EXPECT_EQ(insert(round).mean, expected);
  viewpoints_ = {viewpoint({-1, 0, -1}, {-1, 0, -1}, 0)};
  EXPECT_GT(insert(round).size(), 100U) << "when somebody has come there";
}

TEST_P(InsertionTest, StopsWhereThereIsNoRoom) {
  options_.select.room = 100;
  options_.batch_size = 30;
  const HostRound round = floor_round(-1, 1);
  const HostGaussians inserted = insert(round);
  EXPECT_EQ(result_.batches.size(), 4U);
  EXPECT_EQ(result_.batches.back().size(), 10U);
  EXPECT_EQ(inserted.mean, std::vector<glm::vec3>(round.position.begin(), round.position.begin() + 100));
  EXPECT_EQ(inserter_->modelled().size(), 100U);
  options_.select.room = 0;
  EXPECT_EQ(insert(round).size(), 0U);
}

TEST_P(InsertionTest, BatchesAreFoundAndAddedAgain) {
  insert(floor_round(-1, 1));
  const InsertBatch batch = result_.batches.front();
  EXPECT_TRUE(inserter_->holds_any(batch));
  inserter_->clear();
  EXPECT_FALSE(inserter_->holds_any(batch));
  EXPECT_EQ(inserter_->cells().modelled(), 0U);
  insert(floor_round(2, 3));
  EXPECT_FALSE(inserter_->holds_any(batch));
  inserter_->add(std::vector{&batch});
  EXPECT_TRUE(inserter_->holds_any(batch));
  EXPECT_EQ(insert(floor_round(-1, 1)).size(), 0U) << "modelled again";
}

TEST_P(InsertionTest, NothingIsNothing) {
  EXPECT_EQ(insert(empty_round()).size(), 0U);
  HostRound garbage = floor_round(-1, 1);
  for (float& spacing : garbage.spacing_m) spacing = -1;
  EXPECT_EQ(insert(garbage).size(), 0U);
  EXPECT_TRUE(result_.cells.empty());
}

TEST_P(InsertionTest, GarbageIsLeftOut) {
  HostRound round = floor_round(0, 0.5F);
  const std::size_t valid = round.size();
  const float nan = std::numeric_limits<float>::quiet_NaN(), infinity = std::numeric_limits<float>::infinity();
  for (int i = 0; i < 9; ++i) add_sample(round, {0.01F * static_cast<float>(i), 1, 0});
  round.position[valid].y = nan;
  round.position[valid + 1].x = infinity;
  round.normal[valid + 2] = {0, 0, 0};
  round.normal[valid + 3] *= 1.06F;
  round.albedo[valid + 4].z = infinity;
  round.color[valid + 5].x = -infinity;
  round.spacing_m[valid + 6] = 0;
  round.spacing_m[valid + 7] = nan;
  round.spacing_m[valid + 8] = 1e9F;
  round.normal[3] *= 1.04F;
  round.albedo[3] = {-1, 0.5F, 2};
  EXPECT_EQ(inserter_->take(incoming(round))->invalid, 9U);
  const HostGaussians inserted = insert(round);
  EXPECT_EQ(inserted.mean, std::vector<glm::vec3>(round.position.begin(), round.position.begin() + 100));
  EXPECT_NEAR(glm::length(inserted.normal[3]), 1, 1e-6F);
  EXPECT_EQ(inserted.albedo[3], glm::vec3(0, 0.5F, 1));
}

TEST_P(InsertionTest, ARoundThatIsOverwrittenIsLost) {
  for (const Device memory : {Device::Cpu, GetParam()}) {
    const HostRound round = room_round({}, 2, 32);
    SentRound sent(round, memory);
    const std::uint64_t copied = inserter_->host_copied_bytes();
    EXPECT_NE(inserter_->take(sent.round()), nullptr);
    EXPECT_EQ(inserter_->host_copied_bytes() - copied, memory == Device::Cpu ? round.size() * kSampleBytes : 0U);
    sent.overwrite();
    EXPECT_EQ(inserter_->take(sent.round()), nullptr);
  }
}

TEST_P(InsertionTest, GaussiansAreFlatAlongTheNormalAndOfTheSpacing) {
  options_.initial = {.scale = 0.4F, .flatness = 0.25F, .opacity = 0.9F};
  options_.select.min_samples = 1;
  for (const glm::vec3& direction : {glm::vec3(1, 2, -0.5F), glm::vec3(0, 0, 1), glm::vec3(0, 0, -1),
                                     glm::vec3(1e-4F, 0, -1), glm::vec3(0.01F, 0.02F, -1), glm::vec3(-1, 2, -3)}) {
    use_cells_of(kCellSize_m);
    HostRound round = empty_round();
    const glm::vec3 normal = glm::normalize(direction);
    add_sample(round, {1, 2, 3}, 9, normal);
    const HostGaussians inserted = insert(round);
    ASSERT_EQ(inserted.size(), 1U);
    EXPECT_EQ(inserted.mean[0], glm::vec3(1, 2, 3));
    EXPECT_LT(glm::distance(glm::exp(inserted.log_scale[0]), glm::vec3(0.4F, 0.4F, 0.1F) * kSpacing), 1e-6F);
    EXPECT_NEAR(glm::length(inserted.rotation[0]), 1, 1e-5F);
    EXPECT_LT(glm::distance(inserted.rotation[0] * glm::vec3(0, 0, 1), normal), 2e-2F);
    EXPECT_NEAR(1 / (1 + std::exp(-inserted.opacity_logit[0])), 0.9F, 1e-5F);
    EXPECT_EQ(inserted.object_id[0], 0U);
  }
}

TEST_P(InsertionTest, TellsSunFromShadow) {
  HostRound round = empty_round();
  Light& light = round.scene.light;
  for (std::size_t k = 0; k < 9; ++k) {
    light.ambient_sh[k] = glm::vec3(0.5F, 0.4F, 0.3F) / (1.0F + static_cast<float>(k));
  }
  light.sun_direction = glm::normalize(glm::vec3(0.3F, 0.9F, 0.2F));
  const glm::vec3 albedo(0.6F, 0.5F, 0.4F);
  const glm::vec3 up = glm::normalize(glm::vec3(0.2F, 1, -0.4F));
  const glm::vec3 ambient = albedo * ambient_reflected(light, up);
  const glm::vec3 sun = albedo * light.sun_irradiance * glm::dot(up, light.sun_direction) / glm::pi<float>();
  const auto add = [&](const glm::vec3& color, const glm::vec3& surface_albedo, const glm::vec3& normal) {
    add_sample(round, {0.02F * static_cast<float>(round.size()), 0, 0}, 7, normal);
    round.color.back() = color;
    round.albedo.back() = surface_albedo;
  };
  add(ambient + sun, albedo, up);
  add(ambient, albedo, up);
  add(ambient + 0.3F * sun, albedo, up);
  add(ambient + 9.0F * sun, albedo, up);
  add(glm::vec3(0), albedo, -up);       // turned away from the sun
  add(glm::vec3(0), glm::vec3(0), up);  // black
  // An object that is turned: its light is the world's.
  round.scene.objects[7] = Rigid{.rotation = glm::angleAxis(1.2F, glm::normalize(glm::vec3(1, 2, 3)))};
  options_.select.min_samples = 1;
  const HostGaussians inserted = insert(round);
  const std::vector<float> expected = {1, 0, 0.3F, 1, 1, 1};
  ASSERT_EQ(inserted.size(), expected.size());
  for (std::size_t i = 0; i < expected.size(); ++i) EXPECT_NEAR(inserted.visibility[i], expected[i], 1e-4F) << i;
}

/// Pages as the trainer's lie: page-major, with room left over in each.
TEST_P(InsertionTest, ModelsInPagesAreReadAsPlainOnes) {
  const device::StreamView stream = device::thread_stream(GetParam());
  constexpr std::uint32_t kShift = 4, kLanes = 1U << kShift, kChannels = 7, kPages = 5;
  const std::vector<PageRange> ranges = {{{.first = 0, .count = 9, .frame_id = 0}, 1},
                                         {{.first = kLanes, .count = 16, .frame_id = 7}, 20},
                                         {{.first = 3 * kLanes, .count = 0, .frame_id = 0}, 1},
                                         {{.first = 4 * kLanes, .count = 5, .frame_id = 1U << 20U}, 0.01F}};
  std::vector<float> pages(std::size_t{kPages} * kChannels * kLanes, 1e6F);
  std::vector<std::map<CellKey, std::uint32_t>> expected;
  for (const PageRange& page : ranges) {
    expected.emplace_back();
    for (std::uint32_t i = page.range.first; i < page.range.first + page.range.count; ++i) {
      float* const lane = pages.data() + std::size_t{i / kLanes} * kChannels * kLanes + i % kLanes;
      const math::Vec3 point{0.03F * static_cast<float>(i), i == 20 ? 1e30F : 1, 2};
      for (std::size_t c = 0; c < 3; ++c) lane[c * kLanes] = c == 0 ? point.x : c == 1 ? point.y : point.z;
      for (std::size_t c = 3; c < 6; ++c) lane[c * kLanes] = c == 4 ? 1.0F : 0.0F;
      if (i != 20) ++expected.back()[cell_at(point * page.metres_per_unit, page.range.frame_id, kCellSize_m)];
    }
  }
  device::Buffer<float> there(stream);
  there.assign(pages);
  device::Buffer<ModelledPoint> points(stream, ranges.size() * kPageLanes);
  const PageCells found = read_pages(stream,
                                     {.surface_point = there.data(),
                                      .normal = there.data() + 3 * kLanes,
                                      .stride = kLanes,
                                      .page_shift = kShift,
                                      .page_stride = std::size_t{kChannels} * kLanes},
                                     ranges, kCellSize_m, points.data());
  ASSERT_EQ(found.first.size(), ranges.size() + 1);
  for (std::size_t i = 0; i < ranges.size(); ++i) {
    std::map<CellKey, std::uint32_t> cells;
    for (std::uint32_t c = found.first[i]; c < found.first[i + 1]; ++c) {
      cells[found.cells[c].key] = found.cells[c].count;
    }
    EXPECT_EQ(cells, expected[i]) << i;
  }
  EXPECT_EQ(points.to_host()[3 * kPageLanes + 2].position.x, 0.03F * (4 * kLanes + 2)) << "in the frame's units";
}

}  // namespace
}  // namespace splatbus::expander::test

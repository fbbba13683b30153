// Insertion on CUDA against the host's: the same rounds on both give the same cells and Gaussians.
#include <gtest/gtest.h>

#include <map>

#include "insertion_fixture.h"
#include "room_scene.h"

namespace splatbus::expander::test {
namespace {

using CellMap = std::map<CellKey, std::pair<std::uint32_t, std::uint32_t>>;

void tell(CellTable& table, CellMap& cells) {
  for (const CellReport& report : table.take(UINT32_MAX, 0)) cells[report.key] = {report.samples, report.modelled};
}

template <class Vector>
double largest_difference(const std::vector<Vector>& a, const std::vector<Vector>& b) {
  double largest = 0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    for (int c = 0; c < Vector::length(); ++c) largest = std::max(largest, std::abs(double{a[i][c]} - b[i][c]));
  }
  return largest;
}

void expect_equal(const HostGaussians& host, const HostGaussians& device) {
  ASSERT_EQ(device.size(), host.size());
  EXPECT_EQ(device.object_id, host.object_id);
  EXPECT_EQ(device.mean, host.mean);
  EXPECT_EQ(device.albedo, host.albedo);
  EXPECT_EQ(device.normal, host.normal);
  EXPECT_LE(largest_difference(host.log_scale, device.log_scale), 2e-6);
  EXPECT_LE(largest_difference(host.rotation, device.rotation), 1e-6);
  for (std::size_t i = 0; i < host.size(); ++i) {
    ASSERT_NEAR(device.opacity_logit[i], host.opacity_logit[i], 1e-6);
    ASSERT_NEAR(device.visibility[i], host.visibility[i], 1e-4);
  }
}

class CudaInsertionTest : public testing::Test {
 protected:
  void SetUp() override {
    if (!has_device(Device::Cuda)) GTEST_SKIP() << "no CUDA device";
    host_ = std::make_unique<GaussianInserter>(Device::Cpu, kCellSize_m);
    device_ = std::make_unique<GaussianInserter>(Device::Cuda, kCellSize_m);
  }

  /// One round through both; returns how many Gaussians it gave.
  std::size_t compare(const HostRound& round, const InsertOptions& options = {},
                      std::span<const Viewpoint> viewpoints = {}) {
    const SentRound sent(round, Device::Cuda);
    const auto expected = host_->take(incoming(round));
    const auto got = device_->take(sent.round());
    EXPECT_EQ(got->invalid, expected->invalid);
    const InsertResult a = host_->insert(*expected, viewpoints, options),
                       b = device_->insert(*got, viewpoints, options);
    EXPECT_EQ(b.selected, a.selected);
    EXPECT_EQ(b.batches.size(), a.batches.size());
    expect_equal(on_host(a.batches), on_host(b.batches));
    tell(host_->cells(), host_cells_);
    tell(device_->cells(), device_cells_);
    EXPECT_EQ(device_cells_, host_cells_);
    EXPECT_EQ(device_->modelled().size(), host_->modelled().size());
    return a.selected;
  }

  std::unique_ptr<GaussianInserter> host_, device_;
  CellMap host_cells_, device_cells_;
};

TEST_F(CudaInsertionTest, RoundsGrowTheSameModel) {
  RoomScene scene;
  EXPECT_GT(compare(room_round(scene, 6, 64), {.batch_size = 5001}), 20000U);
  EXPECT_EQ(compare(room_round(scene, 6, 64)), 0U) << "the same again";
  // Seen from elsewhere, with the ball moved and turned: gaps are topped up.
  scene.world_from_ball = {glm::angleAxis(0.7F, glm::normalize(glm::vec3(1, 2, 3))), {-0.4F, 1.1F, 0.6F}};
  EXPECT_GT(compare(room_round(scene, 7, 80, 0.3F)), 100U);
  EXPECT_EQ(device_->host_copied_bytes(), 0U);
}

TEST_F(CudaInsertionTest, OptionsMeanTheSame) {
  const HostRound round = room_round({}, 4, 48);
  InsertOptions options{.select = {.reach_m = 3, .min_pixels = 1e6F, .room = 777}, .batch_size = 100};
  const std::vector<Viewpoint> viewpoints{{.position = {1, 1, 1}, .ahead = {-1, 1, 2}, .focal_px = 50}};
  EXPECT_EQ(compare(round, options, viewpoints), 777U) << "no more room";
  options.select.room = UINT32_MAX;
  options.select.min_samples = 30;
  options.select.refine_share = 0.1F;
  EXPECT_GT(compare(round, options, viewpoints), 100U);
  options.select.hole_distance = 4;  // spheres that reach into all neighbours
  options.select.new_distance = 3;
  EXPECT_GT(compare(room_round({}, 5, 56, 0.4F), options), 100U);
}

}  // namespace
}  // namespace splatbus::expander::test

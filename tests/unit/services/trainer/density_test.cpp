// Clone and split (Kerbl et al. 2023, section 5.2) of Gaussians with planted gradients.
#include "trainer/density.h"

#include <gtest/gtest.h>

#include <cmath>

#include "model_store_fixture.h"

namespace splatbus::trainer {
namespace {

raster::ParameterGradient gradient_of(const GaussiansView& gaussians, const std::vector<std::uint8_t>& touched,
                                      const std::vector<float>& mean2d_norm) {
  raster::ParameterGradient gradient;
  gradient.clear_statistics(gaussians);
  gradient.touched = touched;
  gradient.mean2d_norm = mean2d_norm;
  return gradient;
}

TEST_F(ModelStoreTest, ClonesTheSmallAndSplitsTheLargeWhoseMeanGradientIsLarge) {
  constexpr std::size_t kCount = 4;
  InsertBatch rows = sample_batch(kEpoch, 1, kCount);
  for (std::size_t i = 0; i < 3 * kCount; ++i) rows.log_scale[i] = std::log(i % kCount == 1 ? 0.2F : 0.05F);
  store_->change([&] { store_->append(rows); });
  Densifier densifier(1);
  densifier.resize(kCount);
  densifier.observe(gradient_of(store_->view(), {1, 1, 1, 0}, {0.6F, 0.8F, 0.9F, 9.0F}));
  densifier.observe(gradient_of(store_->view(), {1, 0, 1, 0}, {0.5F, 9.0F, 0.05F, 9.0F}));
  // Means over the steps that saw them: 0.55, 0.8, 0.475, none.
  const DensifyOptions options{.enabled = true, .gradient_threshold = 0.5F, .clone_max_scale_m = 0.1F};
  store_->change([&] {
    const auto added = densifier.densify(*store_, options);
    EXPECT_EQ(added.first, kCount);
    EXPECT_EQ(added.count, 2U);
  });
  ASSERT_EQ(store_->count(), 6U);
  const GaussiansView view = store_->view();
  for (int c = 0; c < view.layout.channels(); ++c) EXPECT_EQ(view.plane(c)[4], view.plane(c)[0]) << "a clone";
  const std::vector<float>* const planes[] = {&rows.mean, &rows.log_scale};
  for (int c = 0; c < 3; ++c) {
    const auto row = [&](int kind, std::size_t i) { return (*planes[kind])[static_cast<std::size_t>(c) * kCount + i]; };
    for (const std::size_t i : {0U, 2U, 3U}) {
      EXPECT_EQ(view.plane(ParameterLayout::kMean + c)[i], row(0, i));
      EXPECT_EQ(view.plane(ParameterLayout::kLogScale + c)[i], row(1, i));
    }
    for (const std::size_t i : {1U, 5U}) {  // the two that a split leaves
      EXPECT_NEAR(view.plane(ParameterLayout::kLogScale + c)[i], std::log(0.2F / 1.6F), 1e-6F);
      const float moved_m = std::abs(view.plane(ParameterLayout::kMean + c)[i] - row(0, 1));
      EXPECT_GT(moved_m, 0.0F);
      EXPECT_LT(moved_m, 6 * 0.2F);
    }
    EXPECT_NE(view.plane(ParameterLayout::kMean + c)[1], view.plane(ParameterLayout::kMean + c)[5]);
  }
  EXPECT_EQ(by_id(view).size(), 6U);
  densifier.resize(6);
  store_->change(
      [&] { EXPECT_EQ(densifier.densify(*store_, options).count, 0U) << "what was collected is forgotten"; });
}

}  // namespace
}  // namespace splatbus::trainer

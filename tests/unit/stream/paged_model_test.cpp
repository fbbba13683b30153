#include "../gaussians/paged_model.h"

#include <gtest/gtest.h>

#include "quantize_once.h"
#include "toy_model.h"

namespace splatbus::stream {
namespace {

class PagedQuantizer : public testing::TestWithParam<Appearance> {};

TEST_P(PagedQuantizer, IsQuantizedAsOneWithoutPages) {
  const GaussiansBuffer model = test::toy_model(5000, 9, 100, GetParam());
  const splatbus::test::PagedModel paged(model.view(), 600);
  ASSERT_GE(paged.ranges.size(), 8U);
  EXPECT_EQ(test::choose_mean_step(paged.view()), test::choose_mean_step(model.view()));
  const StreamLayout layout(model.layout(), test::choose_mean_step(model.view()));
  const test::Quantized expected = test::quantize_once(model.view(), layout);
  const test::Quantized found = test::quantize_once(paged.view(), layout);
  ASSERT_EQ(found.gaussians.count(), 5000U);
  for (std::size_t column = 0; column < paged.source.size(); ++column) {
    const std::size_t i = paged.source[column];
    ASSERT_EQ(found.gaussians.gaussian_id[column], expected.gaussians.gaussian_id[i]);
    ASSERT_EQ(found.gaussians.object_id[column], expected.gaussians.object_id[i]);
    ASSERT_EQ(found.usable[column], expected.usable[i]);
    for (std::size_t c = 0; c < found.gaussians.channels.size(); ++c) {
      ASSERT_EQ(found.gaussians.channels[c][column], expected.gaussians.channels[c][i]) << c;
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Appearances, PagedQuantizer, testing::Values(Appearance::Transfer, Appearance::Radiance));

}  // namespace
}  // namespace splatbus::stream

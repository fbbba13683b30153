#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <map>

#include "gaussians/pages.h"
#include "quantize_once.h"
#include "toy_model.h"

namespace splatbus::stream {
namespace {

/// The Gaussians of a model in pages of a few each, those of one object together; what lies beyond them is garbage.
struct Paged {
  explicit Paged(const GaussiansBuffer& model) : layout(model.layout()) {
    const GaussiansView in = model.view();
    const auto channels = static_cast<std::size_t>(layout.channels());
    std::map<std::uint32_t, std::vector<std::size_t>> of_frame;
    for (std::size_t i = 0; i < in.count; ++i) of_frame[in.object_id[i]].push_back(i);
    for (const auto& [frame_id, members] : of_frame) {
      for (std::size_t k = 0; k < members.size(); k += 600) {
        const auto count = static_cast<std::uint32_t>(std::min<std::size_t>(600, members.size() - k));
        const auto page = static_cast<std::uint32_t>(ranges.size());
        ranges.push_back({page * kPageLanes, count, frame_id});
        words = (channels + 6) * kPageLanes;
        memory.resize((page + 1) * words, std::numeric_limits<float>::quiet_NaN());
        float* const block = memory.data() + page * words;
        auto* const ids = reinterpret_cast<std::uint64_t*>(block + (channels + 4) * kPageLanes);
        for (std::uint32_t lane = 0; lane < count; ++lane) {
          const std::size_t i = members[k + lane];
          for (std::size_t c = 0; c < channels; ++c) block[c * kPageLanes + lane] = in.plane(static_cast<int>(c))[i];
          for (std::size_t c = 0; c < 3; ++c) block[(channels + c) * kPageLanes + lane] = in.normal[c * in.stride + i];
          block[(channels + 3) * kPageLanes + lane] = in.visibility[i];
          ids[lane] = in.gaussian_id[i];
          source.push_back(i);
        }
      }
    }
  }
  [[nodiscard]] GaussiansView view() const {
    const auto channels = static_cast<std::size_t>(layout.channels());
    GaussiansView out;
    out.layout = layout;
    out.count = ranges.back().first + ranges.back().count;
    out.stride = kPageLanes;
    out.page_shift = kPageShift;
    out.page_stride = words;
    out.ranges = ranges;
    out.parameters = memory.data();
    out.normal = memory.data() + channels * kPageLanes;
    out.visibility = memory.data() + (channels + 3) * kPageLanes;
    out.gaussian_id = reinterpret_cast<const std::uint64_t*>(memory.data() + (channels + 4) * kPageLanes);
    return out;
  }

  ParameterLayout layout;
  std::size_t words = 0;
  std::vector<float> memory;
  std::vector<IndexRange> ranges;
  std::vector<std::size_t> source;  ///< of each column: the model's Gaussian
};

class PagedModel : public testing::TestWithParam<Appearance> {};

TEST_P(PagedModel, IsQuantizedAsOneWithoutPages) {
  const GaussiansBuffer model = test::toy_model(5000, 9, 100, GetParam());
  const Paged paged(model);
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

INSTANTIATE_TEST_SUITE_P(Appearances, PagedModel, testing::Values(Appearance::Transfer, Appearance::Radiance));

}  // namespace
}  // namespace splatbus::stream

#include "stream/quantized.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <limits>
#include <numeric>

#include "quantize_once.h"
#include "stream/display_gaussians.h"
#include "stream/replicated_state.h"
#include "toy_model.h"

namespace splatbus::stream {
namespace {

glm::mat3 covariance(const GaussiansView& g, std::size_t i) {
  const glm::quat q = glm::normalize(glm::quat(g.plane(6)[i], g.plane(7)[i], g.plane(8)[i], g.plane(9)[i]));
  glm::mat3 m = glm::mat3_cast(q);
  for (int c = 0; c < 3; ++c) m[c] *= std::exp(g.plane(3 + c)[i]);
  return m * glm::transpose(m);
}

DisplayGaussians shown(const StreamLayout& layout, const QuantizedGaussians& gaussians) {
  DisplayChanges changes;
  changes.add(DisplayReset{layout});
  const auto count = static_cast<std::uint32_t>(gaussians.count());
  std::vector<std::uint32_t> rows(count);
  std::iota(rows.begin(), rows.end(), 0U);
  changes.add(DisplayRows{rows, gaussians});
  DisplayBlocks blocks;
  for (std::uint32_t first = 0; first < count; first += kBlockRows) {
    blocks.blocks.push_back({first / kBlockRows, std::min(kBlockRows, count - first)});
  }
  changes.add(blocks);
  DisplayGaussians display;
  display.apply(changes);
  return display;
}

struct RoundTrip {
  explicit RoundTrip(const GaussiansBuffer& model) : layout(model.layout(), test::choose_mean_step(model.view())) {
    quantized = test::quantize_once(model.view(), layout).gaussians;
    display = shown(layout, quantized);
  }
  StreamLayout layout;
  QuantizedGaussians quantized;
  DisplayGaussians display;
};

TEST(Quantize, ErrorIsWithinHalfAStepOfEachAttribute) {
  const GaussiansBuffer model = test::toy_model(2000, 5);
  const RoundTrip trip(model);
  const GaussiansView in = model.view(), out = trip.display.view();
  ASSERT_EQ(out.count, in.count);
  const float mean_step = trip.layout.at(Attribute::Mean).quantizer.step;
  for (std::size_t i = 0; i < in.count; ++i) {
    for (int c = 0; c < 3; ++c) {
      ASSERT_NEAR(out.plane(c)[i], in.plane(c)[i], 0.501F * mean_step);
      ASSERT_NEAR(out.plane(3 + c)[i], in.plane(3 + c)[i], 0.501F / 64);
      ASSERT_NEAR(srgb_from_linear(out.plane(11 + c)[i]), srgb_from_linear(in.plane(11 + c)[i]), 0.51F / 255);
    }
    for (int c = 14; c < 41; ++c) ASSERT_NEAR(out.plane(c)[i], in.plane(c)[i], 0.501F / 128);
    const auto sigmoid = [](float x) { return 1 / (1 + std::exp(-x)); };
    ASSERT_NEAR(sigmoid(out.plane(10)[i]), sigmoid(in.plane(10)[i]), 0.51F / 255);
    const glm::vec3 n(in.normal[i], in.normal[in.stride + i], in.normal[2 * in.stride + i]);
    const glm::vec3 m(out.normal[i], out.normal[out.stride + i], out.normal[2 * out.stride + i]);
    ASSERT_GT(glm::dot(glm::normalize(n), m), std::cos(0.004F));
    ASSERT_NEAR(out.visibility[i], in.visibility[i], 0.51F / 255);
  }
}

TEST(Quantize, RotationKeepsTheCovarianceWhicheverEquivalentItWrites) {
  const GaussiansBuffer model = test::toy_model(500, 6);
  GaussiansBuffer turned = GaussiansBuffer::copy_of(model.view());
  for (std::size_t i = 0; i < turned.count(); ++i) {
    // Half a turn about the Gaussian's own y axis, and the other sign.
    float* p = turned.parameters.data() + 6 * turned.stride() + i;
    const std::size_t s = turned.stride();
    const glm::quat q = -(glm::quat(p[0], p[s], p[2 * s], p[3 * s]) * glm::quat(0, 0, 1, 0));
    p[0] = q.w, p[s] = q.x, p[2 * s] = q.y, p[3 * s] = q.z;
  }
  const RoundTrip a(model), b(turned);
  for (std::size_t i = 0; i < model.count(); ++i) {
    const glm::mat3 want = covariance(model.view(), i), got = covariance(b.display.view(), i);
    const float largest = std::max({want[0][0], want[1][1], want[2][2]});
    for (int c = 0; c < 3; ++c) {
      for (int r = 0; r < 3; ++r) ASSERT_NEAR(got[c][r], want[c][r], 0.05F * largest);
    }
    for (int c = 0; c < 3; ++c) {
      ASSERT_NEAR(a.quantized.channels[6 + c][i], b.quantized.channels[6 + c][i], 1) << "the same integers for both";
    }
  }
}

TEST(Quantize, RotationStaysNearWhatIsHeld) {
  GaussiansBuffer model = test::toy_model(1, 7);
  const StreamLayout layout(model.layout(), 0.001F);
  QuantizedGaussians held, next;
  const auto turn = [&](float angle) {
    const glm::quat q = glm::angleAxis(angle, glm::normalize(glm::vec3(1, 2, 3)));
    const float values[]{q.w, q.x, q.y, q.z};
    for (int c = 0; c < 4; ++c) model.parameters[static_cast<std::size_t>(6 + c) * model.stride()] = values[c];
  };
  turn(0);
  held = test::quantize_once(model.view(), layout).gaussians;
  for (int step = 0; step < 600; ++step) {
    const float angle = 0.01F * static_cast<float>(step);
    turn(angle);
    const HeldGaussians rows = test::held_of(held, layout);
    next = test::quantize_once(model.view(), layout, &rows, {0}).gaussians;
    for (int c = 6; c < 9; ++c) ASSERT_LE(std::abs(next.channels[c][0] - held.channels[c][0]), 3) << "at " << angle;
    held = next;
  }
}

TEST(Quantize, ARotationAndItsNegativeAreTheSame) {
  GaussiansBuffer model = test::toy_model(200, 17);
  const StreamLayout layout(model.layout(), 0.001F);
  QuantizedGaussians held, next;
  std::vector<std::uint32_t> columns(model.count());
  std::iota(columns.begin(), columns.end(), 0U);
  held = test::quantize_once(model.view(), layout).gaussians;
  for (int c = 6; c < 10; ++c) {
    for (std::size_t i = 0; i < model.count(); ++i)
      model.parameters[static_cast<std::size_t>(c) * model.stride() + i] *= -1;
  }
  const HeldGaussians rows = test::held_of(held, layout);
  next = test::quantize_once(model.view(), layout, &rows, columns).gaussians;
  for (std::size_t c = 6; c < 9; ++c) {
    for (std::size_t i = 0; i < model.count(); ++i) ASSERT_NEAR(next.channels[c][i], held.channels[c][i], 1);
  }
}

TEST(MeanStep, IsA32ndOfTheSecondLargestScale) {
  const float scales[] = {std::log(0.001F), std::log(0.3F), std::log(5.0F)};
  for (const auto& order : {std::array{0, 1, 2}, {0, 2, 1}, {1, 0, 2}, {1, 2, 0}, {2, 0, 1}, {2, 1, 0}}) {
    GaussiansBuffer model(ParameterLayout{}, 3);
    for (std::size_t i = 0; i < 3; ++i) {
      for (std::size_t c = 0; c < 3; ++c) model.parameters[(3 + c) * model.stride() + i] = scales[order[c]];
    }
    EXPECT_EQ(test::choose_mean_step(model.view()), 1.0F / 128);  // 0.3 / 32 is 0.0094
  }
}

TEST(Quantize, MarksWhatIsNotFinite) {
  GaussiansBuffer model = test::toy_model(4, 8);
  model.parameters[1] = std::numeric_limits<float>::quiet_NaN();
  model.parameters[20 * model.stride() + 2] = std::numeric_limits<float>::infinity();
  const StreamLayout layout(model.layout(), 0.001F);
  const auto [out, usable] = test::quantize_once(model.view(), layout);
  EXPECT_EQ(usable, (std::vector<std::uint8_t>{1, 0, 0, 1}));
}

TEST(Quantize, ClampsHugeValues) {
  GaussiansBuffer model = test::toy_model(1, 9);
  model.parameters[0] = 3e38F;
  model.parameters[1 * model.stride()] = -3e38F;
  model.parameters[11 * model.stride()] = 1e30F;
  const StreamLayout layout(model.layout(), 0.001F);
  const auto [out, usable] = test::quantize_once(model.view(), layout);
  EXPECT_EQ(out.channels[0][0], layout.at(Attribute::Mean).maximum);
  EXPECT_EQ(out.channels[1][0], layout.at(Attribute::Mean).minimum);
  EXPECT_EQ(out.channels[layout.at(Attribute::Albedo).first][0], layout.at(Attribute::Albedo).maximum);
}

TEST(QuantizedGaussians, RemoveClosesTheGapsInOrder) {
  const GaussiansBuffer model = test::toy_model(10, 10);
  RoundTrip trip(model);
  const std::vector<std::uint32_t> gone{0, 3, 4, 9}, kept{1, 2, 5, 6, 7, 8};
  const QuantizedGaussians want = trip.quantized.gather(kept);
  trip.quantized.remove(gone);
  EXPECT_EQ(trip.quantized, want);
}

}  // namespace
}  // namespace splatbus::stream

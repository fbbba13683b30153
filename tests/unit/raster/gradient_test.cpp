// Gradients against central differences of the forward pass, which is written down again here in double precision.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include "scenes.h"

namespace splatbus::raster {
namespace {

using testing::TestScene;
using Values = std::vector<double>;  ///< of one Gaussian, channel by channel

constexpr std::uint32_t kWidth = 24, kHeight = 20, kPixels = kWidth * kHeight;
constexpr std::uint32_t kPlanes = 5;  ///< red, green, blue, alpha, depth
constexpr double kAlphaMost = 0.999;

struct Footprint {
  double z = 0, alpha = 0;
  glm::dvec2 at{0}, tangent{0};
  glm::dmat2 inverse_covariance{1};
  glm::dvec3 colour{0};
};

/// Local affine projection with the tangent's clamp, and radiance of degree 1 (rasterizer.h says the rest).
Footprint footprint_of(const Values& g, const Camera& camera, const RenderOptions& options) {
  const glm::dvec3 mean(g[0], g[1], g[2]), eye(camera.world_from_camera.translation);
  const glm::dmat3 camera_from_world =
      glm::transpose(glm::mat3_cast(glm::normalize(glm::dquat(camera.world_from_camera.rotation))));
  const glm::dvec3 p = camera_from_world * (mean - eye);
  const glm::dvec2 focal(camera.fx, camera.fy), centre(camera.cx, camera.cy), size(kWidth, kHeight);
  Footprint out;
  out.z = p.z;
  out.tangent = glm::dvec2(p) / p.z;
  out.at = centre + focal * out.tangent;
  const glm::dvec2 beyond = 0.3 * 0.5 * size / focal;
  const glm::dvec2 t = glm::clamp(out.tangent, -centre / focal - beyond, (size - centre) / focal + beyond);

  const glm::dmat2x3 jacobian_rows(glm::dvec3(focal.x, 0, -focal.x * t.x) / p.z,
                                   glm::dvec3(0, focal.y, -focal.y * t.y) / p.z);
  const glm::dmat3 rotation = glm::mat3_cast(glm::normalize(glm::dquat(g[6], g[7], g[8], g[9])));
  glm::dmat2x3 rows = glm::transpose(camera_from_world * rotation) * jacobian_rows;
  for (int row = 0; row < 2; ++row) rows[row] *= glm::exp(glm::dvec3(g[3], g[4], g[5]));
  const glm::dmat2 sharp = glm::transpose(rows) * rows, blurred = sharp + glm::dmat2(double{options.blur_px2});
  out.inverse_covariance = glm::inverse(blurred);
  out.alpha = 1 / (1 + std::exp(-g[10]));
  if (options.antialias) out.alpha *= std::sqrt(glm::determinant(sharp) / glm::determinant(blurred));

  const glm::dvec3 d = glm::normalize(mean - eye);
  const std::array<double, 4> basis{0.28209479177387814, -0.4886025119029199 * d.y, 0.4886025119029199 * d.z,
                                    -0.4886025119029199 * d.x};
  for (int c = 0; c < 3; ++c) {
    out.colour[c] = 0.5;
    for (std::size_t k = 0; k < 4; ++k) out.colour[c] += basis[k] * g[11 + 3 * k + static_cast<std::size_t>(c)];
    out.colour[c] = std::max(out.colour[c], 0.0);
  }
  return out;
}

struct Picture {
  std::vector<double> planes = std::vector<double>(std::size_t{kPlanes} * kPixels);
  std::size_t clamped = 0;  ///< pixels of Gaussians whose alpha is at its most
};

Picture picture_of(const std::vector<Values>& gaussians, const Camera& camera, const glm::dvec3& background,
                   const RenderOptions& options) {
  std::vector<Footprint> order;
  for (const Values& g : gaussians) order.push_back(footprint_of(g, camera, options));
  std::sort(order.begin(), order.end(), [](const Footprint& a, const Footprint& b) { return a.z < b.z; });
  Picture out;
  for (std::size_t pixel = 0; pixel < kPixels; ++pixel) {
    const glm::dvec2 at(static_cast<double>(pixel % kWidth) + 0.5, static_cast<double>(pixel / kWidth) + 0.5);
    std::array<double, kPlanes> sum{};
    double transmittance = 1;
    for (const Footprint& g : order) {
      const glm::dvec2 off = at - g.at;
      const double alpha = g.alpha * std::exp(-0.5 * glm::dot(off, g.inverse_covariance * off));
      if (alpha < 1.0 / 255 || transmittance < 1e-4) continue;
      out.clamped += alpha > kAlphaMost ? 1 : 0;
      const double weight = std::min(alpha, kAlphaMost) * transmittance;
      transmittance -= weight;
      for (int c = 0; c < 3; ++c) sum[static_cast<std::size_t>(c)] += weight * g.colour[c];
      sum[4] += weight * g.z;
    }
    for (int c = 0; c < 3; ++c) sum[static_cast<std::size_t>(c)] += transmittance * background[c];
    sum[3] = 1 - transmittance;
    for (std::size_t plane = 0; plane < kPlanes; ++plane) out.planes[plane * kPixels + pixel] = sum[plane];
  }
  return out;
}

class Gradient : public ::testing::TestWithParam<bool> {
 protected:
  Gradient() {
    options.antialias = GetParam();
    options.depth = true;
    scene.state.light.background = {0.1F, 0.4F, 0.7F};
    const auto near_one = [&](std::size_t i) { return 1 + 0.1F * static_cast<float>(i); };
    for (std::size_t i = 0; i < scene.count; ++i) {
      for (int c = 0; c < 12; ++c) scene.at(11 + c, i) = std::sin(1.7F * static_cast<float>(c) + near_one(i));
    }
    place(0, {0.10F, -0.10F, 2.0F}, {0.30F, 0.15F, 0.08F}, {0.9F, 0.3F, -0.5F, 0.4F}, 0.3F);
    place(1, {-0.20F, 0.15F, 3.0F}, {0.50F, 0.20F, 0.40F}, {-0.3F, 0.8F, 0.2F, 1.1F}, -0.5F);
    place(kBeyondX, {1.80F, 0.20F, 2.1F}, {0.70F, 0.50F, 0.90F}, {0.5F, -0.6F, 0.3F, 0.7F}, 1.5F);
    place(kBeyondY, {-0.10F, -1.90F, 2.2F}, {0.60F, 0.90F, 0.50F}, {1.2F, 0.2F, 0.9F, -0.4F}, 1.0F);
    place(kDark, {-0.50F, 0.30F, 2.5F}, {0.20F, 0.40F, 0.30F}, {0.4F, 0.4F, -0.9F, 0.1F}, 0.0F);
    scene.at(11, kDark) = -4;  // less than no red
    place(kOpaque, {0.15F, 0.10F, 6.0F}, {12.0F, 9.0F, 7.0F}, {0.7F, 0.2F, 0.1F, -0.6F}, 10.0F);
  }
  void place(std::size_t i, const glm::vec3& of_camera, const glm::vec3& scale, const glm::vec4& wxyz, float logit) {
    const glm::vec3 mean = camera.world_from_camera * of_camera;
    for (int c = 0; c < 3; ++c) {
      scene.at(c, i) = mean[c];
      scene.at(3 + c, i) = std::log(scale[c]);
    }
    for (int c = 0; c < 4; ++c) scene.at(6 + c, i) = wxyz[c];
    scene.at(10, i) = logit;
  }
  [[nodiscard]] std::vector<Values> values() {
    std::vector<Values> of(scene.count);
    for (std::size_t i = 0; i < scene.count; ++i) {
      for (int c = 0; c < scene.layout.channels(); ++c) of[i].push_back(scene.at(c, i));
    }
    return of;
  }
  [[nodiscard]] Picture truth(const std::vector<Values>& of) const {
    glm::dvec3 background;
    for (int c = 0; c < 3; ++c) background[c] = srgb_from_linear(scene.state.light.background[c]);
    return picture_of(of, camera, background, options);
  }

  static constexpr std::size_t kBeyondX = 2, kBeyondY = 3, kDark = 4, kOpaque = 5;
  TestScene scene{testing::radiance_layout(1), 6};
  Camera camera = testing::test_camera(kWidth, kHeight);
  RenderOptions options;
};

TEST_P(Gradient, OfEveryParameterIsTheSlopeOfTheForwardPass) {
  const auto rasterizer = make_cpu_rasterizer(1);
  Render render;
  rasterizer->forward(scene.view(), camera, scene.state, options, render);
  const std::vector<Values> at = values();
  const Picture whole = truth(at);
  for (std::size_t i = 0; i < std::size_t{3} * kPixels; ++i) ASSERT_NEAR(render.color.data[i], whole.planes[i], 2e-5);
  for (std::size_t i = 0; i < kPixels; ++i) {
    ASSERT_NEAR(render.alpha.data[i], whole.planes[3 * kPixels + i], 2e-5);
    ASSERT_NEAR(render.depth.data[i], whole.planes[4 * kPixels + i], 1e-4);
  }
  EXPECT_GT(whole.clamped, 3U) << "alpha is at its most somewhere";
  EXPECT_GT(footprint_of(at[kBeyondX], camera, options).tangent.x, 0.7) << "beyond the clamp";
  EXPECT_LT(footprint_of(at[kBeyondY], camera, options).tangent.y, -0.7) << "beyond the clamp";
  EXPECT_EQ(footprint_of(at[kDark], camera, options).colour.x, 0);

  // A loss that weights every pixel of every plane at will.
  std::mt19937 generator(3);
  std::vector<float> weights(whole.planes.size());
  for (float& weight : weights) weight = static_cast<float>(generator() >> 8U) * (2.0F / 16777216.0F) - 0.9F;
  RenderGradient gradient;
  gradient.color = Image(kWidth, kHeight, 3);
  gradient.alpha = gradient.depth = Image(kWidth, kHeight, 1);
  std::copy_n(weights.begin(), 3 * kPixels, gradient.color.data.begin());
  std::copy_n(weights.begin() + 3 * kPixels, kPixels, gradient.alpha.data.begin());
  std::copy_n(weights.begin() + 4 * kPixels, kPixels, gradient.depth.data.begin());
  ParameterGradient ours;
  ours.clear(scene.view());
  rasterizer->backward(gradient, ours);

  const auto slope = [&](std::size_t i, std::size_t channel) {
    constexpr double kStep = 1e-6;
    std::array<double, 2> loss{};
    for (std::size_t side = 0; side < 2; ++side) {
      std::vector<Values> moved = at;
      moved[i][channel] += side == 0 ? -kStep : kStep;
      const Picture picture = truth(moved);
      loss[side] = std::inner_product(weights.begin(), weights.end(), picture.planes.begin(), 0.0);
    }
    return (loss[1] - loss[0]) / (2 * kStep);
  };
  // Mean, log scale, rotation, opacity, constant colour, colour by direction.
  constexpr std::array<std::size_t, 7> kGroups{0, 3, 6, 10, 11, 14, 23};
  for (std::size_t i = 0; i < scene.count; ++i) {
    for (std::size_t group = 0; group + 1 < kGroups.size(); ++group) {
      std::vector<double> expected;
      for (std::size_t c = kGroups[group]; c < kGroups[group + 1]; ++c) expected.push_back(slope(i, c));
      double most = 0;
      for (const double value : expected) most = std::max(most, std::abs(value));
      EXPECT_GT(most, 1e-2) << "Gaussian " << i << ", channels from " << kGroups[group] << ": this shows nothing";
      for (std::size_t k = 0; k < expected.size(); ++k) {
        const std::size_t channel = kGroups[group] + k;
        EXPECT_NEAR(ours.values[channel * scene.stride + i], expected[k], 1e-3 * most)
            << "Gaussian " << i << ", channel " << channel;
      }
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Antialias, Gradient, ::testing::Bool(),
                         [](const auto& of) { return of.param ? "With" : "Without"; });

}  // namespace
}  // namespace splatbus::raster

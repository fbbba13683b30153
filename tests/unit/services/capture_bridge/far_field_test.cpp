// Pixels without a surface that show something are samples of the far field, in the direction in which they show it.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>

#include "sampled_views.h"

namespace splatbus::capture_bridge::test {
namespace {

/// What lies infinitely far away in a direction: the same byte for one and the same direction, from wherever it is
/// seen.
std::uint8_t sky(const glm::vec3& direction) {
  return static_cast<std::uint8_t>(std::lround(140 + 60 * direction.x + 40 * direction.y));
}

std::vector<InputView> views_under(const std::function<Rgba8(const glm::vec3&)>& sky_color) {
  std::vector<Camera> cameras{look_at({0, 1, 4}, {0, 1.5F, 0}, 48, 48, 1), look_at({40, 2, 9}, {38, 3, 0}, 48, 48, 1)};
  for (std::uint32_t i = 0; i < cameras.size(); ++i) cameras[i].id = i;
  std::vector<InputView> views = AnalyticScene().render_all(cameras);
  for (InputView& view : views) {
    view.objects[kFarFieldFrame] = far_field();
    view.light.background = glm::vec3(linear_from_srgb(100.0F / 255));
    const glm::vec3 eye = view.camera.world_from_camera.translation;
    for (std::uint32_t i = 0; i < view.pixels(); ++i) {
      if (view.object_id[i] != 0) continue;
      const auto x = static_cast<float>(i % 48), y = static_cast<float>(i / 48);
      view.color[i] = sky_color(glm::normalize(unproject(view.camera, x + 0.5F, y + 0.5F, 1) - eye));
    }
  }
  return views;
}

std::size_t far_samples(const SampledRound& round) {
  return static_cast<std::size_t>(std::ranges::count(round.samples.object_id, kFarFieldFrame));
}

const ObjectTransforms kWithFarField{{kFarFieldFrame, far_field()}};

TEST(FarField, IsSampledWhereItShows) {
  const auto shown = [](const glm::vec3& direction) { return Rgba8{sky(direction), 20, 200, 0}; };
  const SampledRound round = sample(views_under(shown), kWithFarField, unlimited());
  EXPECT_GT(far_samples(round), 200U);
  for (std::size_t i = 0; i < round.samples.size(); ++i) {
    if (round.samples.object_id[i] != kFarFieldFrame) continue;
    const glm::vec3 from_centre = round.samples.position[i] - kFarFieldCentre;
    ASSERT_NEAR(glm::length(from_centre), kFarFieldRadius, 1e-3F);
    const glm::vec3 direction = from_centre / kFarFieldRadius;
    // A direction is told to a ten thousandth of a radian, and a byte is 1/60 of one at least.
    const float byte = 140 + 60 * direction.x + 40 * direction.y;
    ASSERT_NEAR(round.samples.albedo[i].x, linear_from_srgb(std::round(byte) / 255), 0.01F);
    ASSERT_NEAR(round.samples.albedo[i].z, linear_from_srgb(200.0F / 255), 1e-4F);
    ASSERT_NEAR(glm::dot(round.samples.normal[i], direction), -1, 1e-3F);
  }
}

TEST(FarField, SamplesStandForTheSolidAngleThatShowsIt) {
  constexpr std::size_t kAcross = 48 / kFarFieldStep;
  std::vector<InputView> views = views_under([](const glm::vec3&) { return Rgba8{250, 250, 250, 0}; });
  views.resize(1);
  views[0].camera = look_at({0, 50, 0}, {0, 90, 1}, 48, 48, 1);  // nothing else in sight
  std::ranges::fill(views[0].object_id, 0U);
  std::ranges::fill(views[0].color, Rgba8{250, 250, 250, 0});
  const SampledRound round = sample(views, kWithFarField, unlimited());
  EXPECT_EQ(far_samples(round), kAcross * kAcross);
  // A pyramid of half angles a has a solid angle of 4 asin(sin^2 a).
  const double solid_angle = 4 * std::asin(std::pow(std::sin(0.5), 2));
  const double spacing_m = kFarFieldRadius * std::sqrt(solid_angle / static_cast<double>(kAcross * kAcross));
  double mean_m = 0;
  for (const float spacing : round.samples.spacing_m) mean_m += spacing / static_cast<double>(kAcross * kAcross);
  EXPECT_NEAR(mean_m, spacing_m, 0.08 * spacing_m);
}

TEST(FarField, NothingIsMadeOfThePlainBackground) {
  const auto plain = [](const glm::vec3&) { return Rgba8{100, 101, 99, 0}; };
  EXPECT_EQ(far_samples(sample(views_under(plain), kWithFarField, unlimited())), 0U);
  const auto cloud = [](const glm::vec3&) { return Rgba8{100, 104, 99, 0}; };
  EXPECT_GT(far_samples(sample(views_under(cloud), kWithFarField, unlimited())), 200U);
  EXPECT_EQ(far_samples(sample(views_under(cloud), {}, unlimited())), 0U) << "no far field is asked for";
}

}  // namespace
}  // namespace splatbus::capture_bridge::test

// Light sources and objects' scale against the scalar truth, and against Gaussians that were scaled by hand.
#include <gtest/gtest.h>

#include <algorithm>
#include <stdexcept>

#include "gaussians/transfer.h"
#include "scenes.h"

namespace splatbus::raster {
namespace {

using testing::TestScene;

/// Gaussian i of a scene alone, with its rows of visibility, before a black background.
TestScene alone(const TestScene& scene, std::size_t i) {
  TestScene one(scene.layout, 1);
  one.state = scene.state;
  one.state.light.background = glm::vec3(0);
  for (int c = 0; c < scene.layout.channels(); ++c) {
    one.at(c, 0) = scene.parameters[static_cast<std::size_t>(c) * scene.stride + i];
  }
  for (std::size_t c = 0; c < 3; ++c) one.normal[c * one.stride] = scene.normal[c * scene.stride + i];
  one.visibility[0] = scene.visibility[i];
  one.object_id[0] = scene.object_id[i];
  one.visibility_stride = 1;
  one.visibility_rows = scene.visibility_rows;
  for (std::uint32_t row = 0; row < scene.visibility_rows && !scene.light_visibility.empty(); ++row) {
    one.light_visibility.push_back(scene.light_visibility[row * scene.visibility_stride + i]);
  }
  return one;
}

/// The colour that a picture from a metre away shows of the scene's only Gaussian.
glm::vec3 shown_color(const TestScene& one) {
  const auto found = one.state.objects.find(one.object_id[0]);
  const glm::vec3 mean(one.parameters[0], one.parameters[one.stride], one.parameters[2 * one.stride]);
  const glm::vec3 at = found == one.state.objects.end() ? mean : found->second * mean;
  Render picture;
  make_cpu_rasterizer(1)->render(one.view(), look_at(at + glm::vec3(0.6F, 0.5F, 0.6F), at, 16, 16, 1), one.state, {},
                                 picture);
  constexpr std::size_t kCentre = 8 * 16 + 8;
  const float alpha = picture.alpha.data[kCentre];
  EXPECT_GT(alpha, 0.01F);
  return glm::vec3(picture.color.plane(0)[kCentre], picture.color.plane(1)[kCentre], picture.color.plane(2)[kCentre]) /
         alpha;
}

TEST(Lights, ColourIsThatOfTheScalarTruth) {
  TestScene scene = testing::random_scene(testing::transfer_layout(), 300, {.logit_low = 1}, 31);
  testing::add_sources(scene.state.light);
  testing::add_visibility(scene, 4, 5);
  scene.state.objects.at(7).scale = 1.7F;
  scene.state.objects.at(14).scale = 0.6F;
  scene.state.objects.at(14).emissive = true;
  Light sun_alone = scene.state.light;
  sun_alone.sources.clear();
  std::size_t lit = 0, emissive = 0;
  for (std::size_t i = 0; i < scene.count; ++i) {
    const TestScene one = alone(scene, i);
    const auto found = scene.state.objects.find(one.object_id[0]);
    const ObjectTransform object = found == scene.state.objects.end() ? ObjectTransform() : found->second;
    const glm::vec3 expected = shade_transfer(one.view(), 0, light_in_object(scene.state.light, object));
    EXPECT_LE(glm::distance(shown_color(one), expected), 2e-4F * (1 + glm::length(expected))) << i;
    const glm::vec3 by_sun = shade_transfer(one.view(), 0, light_in_object(sun_alone, object));
    lit += glm::distance(by_sun, expected) > 0.02F ? 1 : 0;
    emissive += object.emissive && by_sun == expected ? 1 : 0;
  }
  EXPECT_GT(lit, scene.count / 3) << "the test shows little";
  EXPECT_GT(emissive, scene.count / 5);
}

TEST(Lights, EmissiveSurfacesShowTheirAlbedo) {
  TestScene scene = testing::random_scene(testing::transfer_layout(), 40, {.logit_low = 1}, 32);
  testing::add_sources(scene.state.light);
  scene.state.objects.at(7).emissive = true;
  for (std::size_t i = 0; i < scene.count; ++i) {
    scene.object_id[i] = 7;
    for (int c = ParameterLayout::kResidual; c < 41; ++c) scene.at(c, i) = 0;
    const glm::vec3 albedo(scene.at(11, i), scene.at(12, i), scene.at(13, i));
    EXPECT_LE(glm::distance(shown_color(alone(scene, i)), albedo), 1e-4F);
  }
}

TEST(Lights, TwiceTheDistanceIsAQuarterOfTheLight) {
  TestScene scene(testing::transfer_layout(), 1);
  scene.state.light.background = glm::vec3(0);
  for (int c = 3; c < 6; ++c) scene.at(c, 0) = std::log(0.05F);
  scene.at(6, 0) = 1;
  scene.at(10, 0) = 5;
  for (int c = 11; c < 14; ++c) scene.at(c, 0) = 0.5F;
  scene.normal[scene.stride] = 1;  // up
  const auto lit_from = [&](float height_m) {
    LightSource lamp{.id = 1, .position = {0, height_m, 0}, .intensity = {1, 2, 4}, .range_m = 1e3F};
    scene.state.light.sources = {lamp};
    return shown_color(scene);
  };
  const glm::vec3 near = lit_from(1), far = lit_from(2);
  EXPECT_NEAR(near.g, 0.5F * 2 / 3.14159265F, 1e-4F);
  EXPECT_NEAR(far.g, near.g / 4, 1e-4F);
  EXPECT_NEAR(lit_from(-1).g, 0, 1e-6F) << "from below";
}

TEST(Lights, MoreSourcesThanASceneMayHaveAreRefused) {
  TestScene scene = testing::random_scene(testing::transfer_layout(), 3, {}, 33);
  scene.state.light.sources.resize(kMaxLightSources + 1);
  Render picture;
  const auto rasterizer = make_cpu_rasterizer(1);
  EXPECT_THROW(rasterizer->render(scene.view(), testing::test_camera(8, 8), scene.state, {}, picture),
               std::invalid_argument);
  scene.state.light.sources.pop_back();
  rasterizer->render(scene.view(), testing::test_camera(8, 8), scene.state, {}, picture);
}

/// Objects' scales moved into the parameters of their Gaussians.
TestScene scaled_by_hand(const TestScene& scene) {
  TestScene out = scene;
  for (auto& [id, object] : out.state.objects) {
    for (std::size_t i = 0; i < out.count; ++i) {
      if (out.object_id[i] != id) continue;
      for (int c = 0; c < 3; ++c) out.at(c, i) *= object.scale;
      for (int c = 3; c < 6; ++c) out.at(c, i) += std::log(object.scale);
    }
    object.scale = 1;
  }
  return out;
}

class Scaled : public ::testing::TestWithParam<ParameterLayout> {};

TEST_P(Scaled, PictureAndGradientsAreThoseOfGaussiansScaledByHand) {
  TestScene scene = testing::random_scene(GetParam(), 200, {}, 34);
  testing::add_sources(scene.state.light);
  testing::add_visibility(scene, 5, 6);
  scene.state.objects.at(7).scale = 2.5F;
  scene.state.objects.at(14).scale = 0.3F;
  TestScene by_hand = scaled_by_hand(scene);
  const Camera camera = testing::test_camera(60, 50);
  const RenderOptions options{.depth = true};
  Render ours, expected;
  ParameterGradient gradient, expected_gradient;
  const auto run = [&](const TestScene& of, Render& picture, ParameterGradient& sums) {
    const auto rasterizer = make_cpu_rasterizer(1);
    rasterizer->forward(of.view(), camera, of.state, options, picture);
    sums.clear(of.view());
    // Of the first picture, so that both have the same gradient.
    rasterizer->backward({.color = ours.color, .alpha = {}, .albedo = {}, .depth = ours.depth}, sums);
  };
  run(scene, ours, gradient);
  run(by_hand, expected, expected_gradient);
  float largest = 0;
  for (std::size_t k = 0; k < ours.color.data.size(); ++k) {
    largest = std::max(largest, std::abs(ours.color.data[k] - expected.color.data[k]));
  }
  EXPECT_LT(largest, 2e-4F);
  for (const std::uint32_t id : {0U, 7U, 14U}) {
    const float scale = id == 0 ? 1 : scene.state.objects.at(id).scale;
    for (int c = 0; c < GetParam().channels(); ++c) {
      double difference = 0, norm = 0;
      for (std::size_t i = 0; i < scene.count; ++i) {
        if (scene.object_id[i] != id) continue;
        const std::size_t at = static_cast<std::size_t>(c) * gradient.stride + i;
        const double value = double{expected_gradient.values[at]} * (c < 3 ? scale : 1);
        difference += std::pow(gradient.values[at] - value, 2);
        norm += value * value;
      }
      EXPECT_LT(std::sqrt(difference), 1e-3 * std::sqrt(norm) + 1e-5) << "object " << id << " channel " << c;
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Layouts, Scaled, ::testing::Values(testing::transfer_layout(), testing::radiance_layout(3)),
                         [](const auto& of) {
                           return of.param.appearance == Appearance::Transfer ? "Transfer" : "Radiance";
                         });

}  // namespace
}  // namespace splatbus::raster

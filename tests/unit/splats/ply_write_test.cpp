#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstring>
#include <sstream>

#include "../gaussians/random.h"
#include "splats/ply.h"

namespace splatbus::splats {
namespace {

std::string written_ply(const GaussiansBuffer& model, const WriteOptions& options = {}) {
  std::ostringstream stream;
  write_ply(stream, BakedModel(model.view(), {}), options);
  return stream.str();
}

GaussiansBuffer read_back(const GaussiansBuffer& model, const WriteOptions& options, Axes axes) {
  std::istringstream stream(written_ply(model, options));
  return read_ply(stream, "model.ply", axes).gaussians;
}

TEST(WritePly, HasTheHeaderThatOtherToolsExpect) {
  const GaussiansBuffer model({Appearance::Radiance, 1}, 0);
  std::string expected = "element vertex 0\n";
  for (const char* name :
       {"x",        "y",        "z",        "nx",       "ny",       "nz",       "f_dc_0",   "f_dc_1",   "f_dc_2",
        "f_rest_0", "f_rest_1", "f_rest_2", "f_rest_3", "f_rest_4", "f_rest_5", "f_rest_6", "f_rest_7", "f_rest_8",
        "opacity",  "scale_0",  "scale_1",  "scale_2",  "rot_0",    "rot_1",    "rot_2",    "rot_3"}) {
    expected += std::string("property float ") + name + "\n";
  }
  expected += "end_header\n";
  const std::string start = "ply\nformat binary_little_endian 1.0\n";
  EXPECT_EQ(written_ply(model), start + "comment SplatRenderMode: mip\n" + expected);
  EXPECT_EQ(written_ply(model, {.axes = Axes::Keep, .mip = false}), start + "comment SplatAxes: y-up\n" + expected);
}

TEST(WritePly, RestCoefficientsLieColourByColour) {
  GaussiansBuffer model({Appearance::Radiance, 1}, 1);
  model.parameters[6] = 1;
  for (std::size_t k = 0; k < 4; ++k) {
    for (std::size_t c = 0; c < 3; ++c) model.parameters[11 + 3 * k + c] = static_cast<float>(10 * k + c);
  }
  const auto colors = [&](Axes axes) {
    const std::string text = written_ply(model, {.axes = axes});
    std::array<float, 26> row{};
    std::memcpy(row.data(), text.data() + text.size() - sizeof row, sizeof row);
    return std::vector<float>(row.begin() + 6, row.begin() + 18);
  };
  EXPECT_THAT(colors(Axes::Keep), testing::ElementsAre(0, 1, 2, 10, 20, 30, 11, 21, 31, 12, 22, 32));
  EXPECT_THAT(colors(Axes::OfFormat), testing::ElementsAre(0, 1, 2, -10, 20, -30, -11, 21, -31, -12, 22, -32));
}

TEST(WritePly, ComesBackAsItWas) {
  test::Random random(13);
  for (int degree = 0; degree <= 3; ++degree) {
    GaussiansBuffer model = random.gaussians({Appearance::Radiance, degree}, degree == 1 ? 5000 : 200);
    model.object_id.assign(model.count(), kWorldFrame);
    for (const Axes axes : {Axes::OfFormat, Axes::Keep}) {
      const GaussiansBuffer back = read_back(model, {.axes = axes}, Axes::OfFormat);
      ASSERT_EQ(back.layout(), model.layout());
      ASSERT_EQ(back.count(), model.count());
      for (std::size_t i = 0; i < model.count(); i += 7) {
        const Splat before = load(model.view(), i), after = load(back.view(), i);
        ASSERT_EQ(after.mean, before.mean);
        ASSERT_EQ(after.normal, before.normal);
        ASSERT_EQ(after.log_scale, before.log_scale);
        ASSERT_EQ(after.opacity_logit, before.opacity_logit);
        ASSERT_EQ(after.sh, before.sh);
        EXPECT_NEAR(std::abs(glm::dot(after.rotation, before.rotation)), 1, 1e-6F);
        for (std::size_t axis = 0; axis < 3; ++axis) {
          EXPECT_EQ(back.surface_point[axis * back.stride() + i], before.mean[static_cast<int>(axis)]);
        }
      }
    }
  }
}

}  // namespace
}  // namespace splatbus::splats

#include "splats/glb.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <nlohmann/json.hpp>
#include <sstream>
#include <stdexcept>

#include "../gaussians/random.h"
#include "gaussians/light.h"

namespace splatbus::splats {
namespace {

using nlohmann::json;

GaussiansBuffer random_model(int degree, std::size_t count) {
  test::Random random(80);
  GaussiansBuffer model = random.gaussians({Appearance::Radiance, degree}, count);
  model.object_id.assign(count, kWorldFrame);
  return model;
}

/// A .glb file taken apart by the text of glTF 2.0.
struct Parsed {
  json gltf;
  std::string binary;

  explicit Parsed(const std::string& file) {
    const auto word = [&](std::size_t at) {
      std::uint32_t value = 0;
      std::memcpy(&value, file.data() + at, sizeof value);
      return std::size_t{value};
    };
    EXPECT_EQ(file.substr(0, 4), "glTF");
    EXPECT_EQ(word(4), 2U);
    EXPECT_EQ(word(8), file.size());
    const std::size_t json_bytes = word(12);
    EXPECT_EQ(json_bytes % 4, 0U);
    EXPECT_EQ(file.substr(16, 4), "JSON");
    gltf = json::parse(file.substr(20, json_bytes));
    EXPECT_EQ(word(20 + json_bytes), file.size() - 28 - json_bytes);
    EXPECT_EQ(file.substr(24 + json_bytes, 4), std::string("BIN\0", 4));
    binary = file.substr(28 + json_bytes);
  }

  [[nodiscard]] const json& primitive() const { return gltf["meshes"][0]["primitives"][0]; }

  /// Component `c` of Gaussian `i`, as a reader of glTF has it.
  [[nodiscard]] double value(const std::string& attribute, std::size_t i, std::size_t c) const {
    const json& accessor = gltf["accessors"][primitive()["attributes"].at(attribute).get<std::size_t>()];
    const json& view = gltf["bufferViews"][accessor["bufferView"].get<std::size_t>()];
    const std::string type = accessor["type"];
    const std::size_t components = type == "SCALAR" ? 1 : static_cast<std::size_t>(type.back() - '0');
    const auto element = i * components + c;
    const std::size_t from = view["byteOffset"];
    const auto at = [&]<class T>(T number) {
      EXPECT_EQ(from % sizeof number, 0U);
      EXPECT_LE((i + 1) * components * sizeof number, view["byteLength"].get<std::size_t>());
      std::memcpy(&number, binary.data() + from + element * sizeof number, sizeof number);
      return number;
    };
    if (accessor["componentType"] == 5126) return at(float{});
    EXPECT_EQ(accessor["componentType"], 5123);
    EXPECT_TRUE(accessor["normalized"]);
    return at(std::uint16_t{}) / 65535.0;
  }
};

Parsed written_glb(const GaussiansBuffer& model, const WriteOptions& options = {}) {
  std::ostringstream stream;
  write_glb(stream, BakedModel(model.view(), {}), options);
  return Parsed(stream.str());
}

TEST(WriteGlb, SaysWhatTheExtensionAsks) {
  const Parsed file = written_glb(random_model(1, 5));
  EXPECT_EQ(file.gltf["asset"]["version"], "2.0");
  EXPECT_EQ(file.gltf["extensionsUsed"], json({"KHR_gaussian_splatting"}));
  EXPECT_FALSE(file.gltf.contains("extensionsRequired")) << "others may show points";
  EXPECT_EQ(file.primitive()["mode"], 0);
  EXPECT_EQ(file.primitive()["extensions"]["KHR_gaussian_splatting"],
            json({{"kernel", "ellipse"}, {"colorSpace", "srgb_rec709_display"}}));
  std::vector<std::string> names;
  for (const auto& [name, accessor] : file.primitive()["attributes"].items()) {
    names.push_back(name);
    EXPECT_EQ(file.gltf["accessors"][accessor.get<std::size_t>()]["count"], 5);
  }
  const std::string khr = "KHR_gaussian_splatting:";
  EXPECT_THAT(names,
              testing::UnorderedElementsAre("POSITION", "COLOR_0", khr + "ROTATION", khr + "SCALE", khr + "OPACITY",
                                            khr + "SH_DEGREE_0_COEF_0", khr + "SH_DEGREE_1_COEF_0",
                                            khr + "SH_DEGREE_1_COEF_1", khr + "SH_DEGREE_1_COEF_2"));
  EXPECT_EQ(file.gltf["buffers"][0]["byteLength"], file.binary.size());
}

TEST(WriteGlb, HoldsEveryValue) {
  const GaussiansBuffer model = random_model(3, 30);
  for (const Axes axes : {Axes::OfFormat, Axes::Turn}) {
    const Parsed file = written_glb(model, {.axes = axes});
    glm::dvec3 low(1e9), high(-1e9);
    for (std::size_t i = 0; i < model.count(); ++i) {
      const Splat splat = axes == Axes::Turn ? turned(load(model.view(), i)) : load(model.view(), i);
      const std::string khr = "KHR_gaussian_splatting:";
      const double opacity = 1 / (1 + std::exp(-double{splat.opacity_logit}));
      EXPECT_NEAR(file.value(khr + "OPACITY", i, 0), opacity, 1e-7);
      EXPECT_NEAR(file.value("COLOR_0", i, 3), opacity, 0.51 / 65535);
      EXPECT_EQ(file.value(khr + "ROTATION", i, 3), splat.rotation.w);
      for (std::size_t c = 0; c < 3; ++c) {
        const auto axis = static_cast<int>(c);
        EXPECT_EQ(file.value("POSITION", i, c), splat.mean[axis]);
        EXPECT_EQ(file.value(khr + "ROTATION", i, c), splat.rotation[axis]);
        EXPECT_NEAR(file.value(khr + "SCALE", i, c), std::exp(double{splat.log_scale[axis]}), 1e-6);
        const double display = std::clamp(0.5 + 0.2820947917738781 * splat.sh[0][axis], 0.0, 1.0);
        const double linear = display <= 0.04045 ? display / 12.92 : std::pow((display + 0.055) / 1.055, 2.4);
        EXPECT_NEAR(file.value("COLOR_0", i, c), linear, 0.6 / 65535);
        for (int l = 0, k = 0; l <= 3; ++l) {
          for (int m = 0; m <= 2 * l; ++m, ++k) {
            EXPECT_EQ(file.value(khr + "SH_DEGREE_" + std::to_string(l) + "_COEF_" + std::to_string(m), i, c),
                      splat.sh[static_cast<std::size_t>(k)][axis]);
          }
        }
      }
      low = glm::min(low, glm::dvec3(splat.mean));
      high = glm::max(high, glm::dvec3(splat.mean));
    }
    const json& position = file.gltf["accessors"][file.primitive()["attributes"]["POSITION"].get<std::size_t>()];
    EXPECT_EQ(position["min"], json({low.x, low.y, low.z}));
    EXPECT_EQ(position["max"], json({high.x, high.y, high.z}));
  }
}

TEST(WriteGlb, RefusesAModelWithoutGaussians) {
  EXPECT_THAT([] { (void)written_glb(random_model(0, 0)); },
              testing::ThrowsMessage<std::runtime_error>(testing::HasSubstr("without Gaussians")));
}

}  // namespace
}  // namespace splatbus::splats

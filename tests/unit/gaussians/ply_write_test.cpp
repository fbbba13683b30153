#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstring>
#include <fstream>
#include <iterator>
#include <stdexcept>

#include "gaussians/model.h"
#include "gaussians/sh.h"
#include "gaussians/transfer.h"
#include "random.h"

namespace splatbus {
namespace {

float at(const GaussiansBuffer& buffer, int channel, std::size_t i) {
  return buffer.view().plane(channel)[i];
}

glm::vec3 mean(const GaussiansBuffer& buffer, std::size_t i) {
  return {at(buffer, 0, i), at(buffer, 1, i), at(buffer, 2, i)};
}

glm::quat rotation(const GaussiansBuffer& buffer, std::size_t i) {
  return glm::normalize(glm::quat(at(buffer, 6, i), at(buffer, 7, i), at(buffer, 8, i), at(buffer, 9, i)));
}

TEST(WritePly, HasTheHeaderThatOtherToolsExpect) {
  const test::TemporaryFolder folder;
  const std::string path = folder.file("model.ply");
  write_ply(path, GaussiansBuffer({Appearance::Radiance, 1}, 0).view(), {});
  std::ifstream file(path, std::ios::binary);
  const std::string text{std::istreambuf_iterator<char>(file), {}};
  std::string expected = "ply\nformat binary_little_endian 1.0\nelement vertex 0\n";
  for (const char* name :
       {"x",        "y",        "z",        "nx",       "ny",       "nz",       "f_dc_0",   "f_dc_1",   "f_dc_2",
        "f_rest_0", "f_rest_1", "f_rest_2", "f_rest_3", "f_rest_4", "f_rest_5", "f_rest_6", "f_rest_7", "f_rest_8",
        "opacity",  "scale_0",  "scale_1",  "scale_2",  "rot_0",    "rot_1",    "rot_2",    "rot_3"}) {
    expected += std::string("property float ") + name + "\n";
  }
  EXPECT_EQ(text, expected + "end_header\n");
}

TEST(WritePly, RestCoefficientsLieColourByColour) {
  const test::TemporaryFolder folder;
  GaussiansBuffer model({Appearance::Radiance, 1}, 1);
  model.parameters[6] = 1;
  for (std::size_t k = 0; k < 4; ++k) {
    for (std::size_t c = 0; c < 3; ++c) model.parameters[11 + 3 * k + c] = static_cast<float>(10 * k + c);
  }
  write_ply(folder.file("model.ply"), model.view(), {});
  std::ifstream file(folder.file("model.ply"), std::ios::binary);
  const std::string text{std::istreambuf_iterator<char>(file), {}};
  std::array<float, 26> row{};
  ASSERT_GE(text.size(), sizeof row);
  std::memcpy(row.data(), text.data() + text.size() - sizeof row, sizeof row);
  const std::vector<float> colors(row.begin() + 6, row.begin() + 18);
  EXPECT_THAT(colors, ::testing::ElementsAre(0, 1, 2, 10, 20, 30, 11, 21, 31, 12, 22, 32));
}

TEST(WritePly, RadianceComesBackAsItWas) {
  const test::TemporaryFolder folder;
  test::Random random(13);
  for (int degree = 0; degree <= 3; ++degree) {
    const GaussiansBuffer model = random.gaussians({Appearance::Radiance, degree}, degree == 1 ? 5000 : 200);
    write_ply(folder.file("model.ply"), model.view(), {});
    const GaussiansBuffer back = read_ply(folder.file("model.ply"));
    ASSERT_EQ(back.layout(), model.layout());
    ASSERT_EQ(back.count(), model.count());
    for (std::size_t i = 0; i < model.count(); i += 7) {
      for (int c = 0; c < model.layout().channels(); ++c) {
        if (c < 6 || c >= 10) {
          ASSERT_EQ(at(back, c, i), at(model, c, i)) << "channel " << c << " of " << i;
        }
      }
      EXPECT_NEAR(std::abs(glm::dot(rotation(back, i), rotation(model, i))), 1, 1e-6F);
      for (std::size_t axis = 0; axis < 3; ++axis) {
        EXPECT_EQ(back.normal[axis * back.stride() + i], model.normal[axis * model.stride() + i]);
        EXPECT_EQ(back.surface_point[axis * back.stride() + i], at(model, static_cast<int>(axis), i));
      }
    }
  }
}

TEST(WritePly, MovesObjectsIntoTheWorld) {
  const test::TemporaryFolder folder;
  test::Random random(14);
  const GaussiansBuffer model = random.gaussians({Appearance::Radiance, 3}, 40);
  SceneState scene;
  scene.objects = {{1, random.rigid()}, {3, random.rigid()}};
  scene.objects.at(3).scale = 2;
  write_ply(folder.file("model.ply"), model.view(), scene);
  const GaussiansBuffer back = read_ply(folder.file("model.ply"));
  for (std::size_t i = 0; i < model.count(); ++i) {
    const auto found = scene.objects.find(model.object_id[i]);
    const ObjectTransform world_from_object = found == scene.objects.end() ? ObjectTransform{} : found->second;
    EXPECT_LE(glm::distance(mean(back, i), world_from_object.rigid.rotation * mean(model, i) * world_from_object.scale +
                                               world_from_object.rigid.translation),
              1e-5F);
    for (int axis = 3; axis < 6; ++axis) {
      EXPECT_NEAR(std::exp(at(back, axis, i) - at(model, axis, i)), world_from_object.scale, 1e-5F);
    }
    EXPECT_NEAR(std::abs(glm::dot(rotation(back, i), world_from_object.rigid.rotation * rotation(model, i))), 1, 1e-6F);
    // The same radiance leaves in the same direction.
    const glm::vec3 d = random.direction();
    const Sh16 world = sh16_basis(d), local = sh16_basis(glm::conjugate(world_from_object.rigid.rotation) * d);
    float seen = 0, expected = 0;
    for (int k = 0; k < 16; ++k) {
      seen += world[static_cast<std::size_t>(k)] * at(back, 11 + 3 * k + 1, i);
      expected += local[static_cast<std::size_t>(k)] * at(model, 11 + 3 * k + 1, i);
    }
    EXPECT_NEAR(seen, expected, 2e-5F);
  }
}

TEST(WritePly, BakesTransferUnderTheLight) {
  const test::TemporaryFolder folder;
  test::Random random(15);
  GaussiansBuffer model = random.gaussians({Appearance::Transfer, 3}, 60);
  for (float& value : model.parameters) value *= 0.5F;
  SceneState scene;
  scene.light = random.light();
  scene.objects = {{2, random.rigid()}};
  write_ply(folder.file("model.ply"), model.view(), scene);
  const GaussiansBuffer back = read_ply(folder.file("model.ply"));
  ASSERT_EQ(back.layout(), (ParameterLayout{Appearance::Radiance, 0}));
  for (std::size_t i = 0; i < model.count(); ++i) {
    const bool moved = model.object_id[i] == 2;
    const glm::quat world_from_object = moved ? scene.objects.at(2).rigid.rotation : glm::quat(1, 0, 0, 0);
    const Light local = light_in_object(scene.light, Rigid{.rotation = world_from_object, .translation = {}});
    const glm::vec3 linear = shade_transfer(model.view(), i, local);
    const glm::vec3 normal(model.normal[i], model.normal[model.stride() + i], model.normal[2 * model.stride() + i]);
    const glm::vec3 in_world(back.normal[i], back.normal[back.stride() + i], back.normal[2 * back.stride() + i]);
    EXPECT_LE(glm::distance(in_world, world_from_object * normal), 1e-5F);
    for (int c = 0; c < 3; ++c) {
      // What another tool shows: 0.5 + C0 f_dc, display space.
      EXPECT_NEAR(0.5F + kShC0 * at(back, 11 + c, i), srgb_from_linear(linear[c]), 1e-5F);
    }
  }
}

TEST(WritePly, LeavesOutWhatIsNotFinite) {
  const test::TemporaryFolder folder;
  test::Random random(18);
  GaussiansBuffer model = random.gaussians({Appearance::Transfer, 3}, 6);
  const std::size_t stride = model.stride();
  model.parameters[0] = std::nanf("");                                        // x of Gaussian 0
  model.parameters[30 * stride + 1] = INFINITY;                               // a residual of Gaussian 1
  model.normal[stride + 2] = std::nanf("");                                   // a normal of Gaussian 2
  model.visibility[3] = std::nanf("");                                        //
  for (std::size_t k = 6; k < 10; ++k) model.parameters[k * stride + 4] = 0;  // no rotation
  write_ply(folder.file("model.ply"), model.view(), {});
  const GaussiansBuffer back = read_ply(folder.file("model.ply"));
  ASSERT_EQ(back.count(), 1U);
  EXPECT_EQ(mean(back, 0), mean(model, 5));
}

TEST(WritePly, ErrorsNameTheFile) {
  const GaussiansBuffer model({}, 1);
  EXPECT_THAT([&] { write_ply("/no/such/folder/model.ply", model.view(), {}); },
              ::testing::ThrowsMessage<std::runtime_error>(::testing::HasSubstr("/no/such/folder/model.ply")));
}

}  // namespace
}  // namespace splatbus

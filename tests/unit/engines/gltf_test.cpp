#include <gmock/gmock.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <fstream>
#include <random>
#include <utility>

#include "../bus/bus_fixture.h"
#include "render_scenes.h"
#include "sim/gltf_scene.h"

namespace splatbus::sim {
namespace {

using testing::HasSubstr;

void append_u32(std::string& bytes, std::uint32_t value) {
  bytes.append(reinterpret_cast<const char*>(&value), sizeof(value));
}

/// The container of glTF 2.0, section 4.4.
std::string glb(std::string json, std::string binary) {
  json.resize((json.size() + 3) / 4 * 4, ' ');
  binary.resize((binary.size() + 3) / 4 * 4, '\0');
  std::string file = "glTF";
  append_u32(file, 2);
  append_u32(file, static_cast<std::uint32_t>(12 + 8 + json.size() + 8 + binary.size()));
  append_u32(file, static_cast<std::uint32_t>(json.size()));
  file += "JSON" + json;
  append_u32(file, static_cast<std::uint32_t>(binary.size()));
  file += std::string("BIN\0", 4) + binary;
  return file;
}

/// A square of 2 m in the plane z = 0 that faces +z, without normals.
std::string square_bytes() {
  const float positions[] = {-1, -1, 0, 1, -1, 0, 1, 1, 0, -1, 1, 0};
  const std::uint16_t indices[] = {0, 1, 2, 0, 2, 3};
  std::string bytes(reinterpret_cast<const char*>(positions), sizeof(positions));
  bytes.append(reinterpret_cast<const char*>(indices), sizeof(indices));
  return bytes;
}

std::string square_json() {
  return R"({"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
    "nodes": [{"name": "parent", "translation": [0, 1, 0], "children": [1, 2]},
              {"name": "near", "mesh": 0, "translation": [0, 0, 2], "scale": [0.5, 0.5, 0.5]},
              {"name": "far", "mesh": 0, "rotation": [0, 0.7071068, 0, 0.7071068]}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
    "materials": [{"pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.25, 0.125, 1]}, "doubleSided": true}],
    "accessors": [{"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [-1, -1, 0], "max": [1, 1, 0]},
                  {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"}],
    "bufferViews": [{"buffer": 0, "byteOffset": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 12}],
    "buffers": [{"byteLength": 60}]})";
}

class Gltf : public testing::Test {
 protected:
  std::string write(const std::string& bytes, const std::string& name = "scene.glb") {
    std::string path = directory_.path() + "/" + name;
    std::ofstream(path, std::ios::binary) << bytes;
    return path;
  }
  /// The square's file with a part of its JSON replaced.
  std::string broken(const std::string& from, const std::string& to) {
    std::string json = square_json();
    const std::size_t at = json.find(from);
    EXPECT_NE(at, std::string::npos) << from;
    json.replace(at, from.size(), to);
    return words(write(glb(json, square_bytes())));
  }
  static std::string words(const std::string& path, const GltfLimits& limits = {}) {
    try {
      static_cast<void>(load_gltf(path, limits));
    } catch (const std::runtime_error& error) {
      EXPECT_THAT(error.what(), HasSubstr(path));
      return error.what();
    }
    return "no error";
  }
  bus_test::TemporaryDirectory directory_;
};

TEST_F(Gltf, NodesWithAMeshAreObjectsInTheirPlaces) {
  Scene scene = load_gltf(write(glb(square_json(), square_bytes())));
  ASSERT_EQ(scene.objects.size(), 2U);
  EXPECT_EQ(scene.objects[0].name, "near");
  EXPECT_EQ(scene.objects[0].id, 1U);
  const glm::vec4 corner = scene.objects[0].world_from_object * glm::vec4(1, 1, 0, 1);
  EXPECT_NEAR(corner.x, 0.5F, 1e-5F);
  EXPECT_NEAR(corner.y, 1.5F, 1e-5F);
  EXPECT_NEAR(corner.z, 2, 1e-5F);
  EXPECT_NEAR(scene.objects[0].parts.at(0).mesh.vertices.at(0).normal.z, 1, 1e-5F);

  Renderer renderer(shared_context(), std::move(scene));
  const splatbus_camera camera = look_at({0, 1, 5}, {0, 1, 0}, 33, 33, 40);
  const Pictures& pictures =
      renderer.render(camera, SPLATBUS_BUFFER_ALBEDO | SPLATBUS_BUFFER_WORLD_POSITION | SPLATBUS_BUFFER_OBJECT_ID);
  const std::size_t middle = 16 * 33 + 16;
  EXPECT_EQ(pictures.object_id[middle], 1U);
  EXPECT_NEAR(pictures.world_position[4 * middle + 2], 2, 1e-4F);
  EXPECT_NEAR(pictures.albedo[4 * middle], 255 * srgb_from_linear(0.5F), 0.75F);
  EXPECT_NEAR(pictures.albedo[4 * middle + 2], 255 * srgb_from_linear(0.125F), 0.75F);
}

TEST_F(Gltf, CentimetresAndAnyAxisUpBecomeMetresWithYUp) {
  // A square of 200 cm that lies on its file's z = 40 and faces up along z, with a corner at x = 100, y = -100.
  std::string json = square_json();
  for (const auto& [from, to] : {std::pair<std::string, std::string>{R"("translation": [0, 1, 0], )", ""},
                                 {R"("translation": [0, 0, 2], "scale": [0.5, 0.5, 0.5])",
                                  R"("translation": [0, 0, 40], "scale": [100, 100, 100])"}}) {
    const std::size_t at = json.find(from);
    ASSERT_NE(at, std::string::npos) << from;
    json.replace(at, from.size(), to);
  }
  const std::string path = write(glb(json, square_bytes()));
  const auto corner = [&](const char* up) {
    const Scene scene = load_gltf(path, {}, {.metres_a_unit = 0.01F, .up = up});
    const Object& square = scene.objects.at(0);
    EXPECT_EQ(square.name, "near");
    // Right-handed still: a reflection would turn the square's face down.
    EXPECT_GT(glm::determinant(glm::mat3(square.world_from_object)), 0) << up;
    return glm::vec3(square.world_from_object * glm::vec4(1, -1, 0, 1));
  };
  const auto expect_at = [&](const char* up, const glm::vec3& place) {
    EXPECT_LT(glm::distance(corner(up), place), 1e-5F) << up;
  };
  expect_at("y", {1, -1, 0.4F});
  expect_at("z", {1, 0.4F, 1});
  expect_at("-y", {1, 1, -0.4F});
  expect_at("-z", {1, -0.4F, -1});
  expect_at("x", {1, 1, 0.4F});
  expect_at("-x", {-1, -1, 0.4F});
  EXPECT_THROW(static_cast<void>(corner("w")), std::runtime_error);
}

TEST_F(Gltf, AFittedCameraHasAllOfTheSceneInView) {
  for (const float metres_a_unit : {0.01F, 1.0F, 40.0F}) {
    Scene scene = load_gltf(write(glb(square_json(), square_bytes())), {}, {.metres_a_unit = metres_a_unit, .up = "z"});
    const Bounds bounds = scene.bounds(false);
    Renderer renderer(shared_context(), std::move(scene));
    const splatbus_camera camera = fit_camera(bounds, 96, 64, 60);
    const glm::mat4 clip_from_world = clip_from_camera(camera) * camera_from_world(camera);
    float widest = 0;
    for (int i = 0; i < 8; ++i) {
      const glm::vec4 clip = clip_from_world * glm::vec4(bounds.corner(i), 1);
      ASSERT_GT(clip.w, 0);
      ASSERT_LT(std::abs(clip.z), clip.w);
      widest = std::max({widest, std::abs(clip.x / clip.w), std::abs(clip.y / clip.w)});
    }
    EXPECT_LT(widest, 1);
    EXPECT_GT(widest, 0.9F) << "it fills the view";
    const Pictures& pictures = renderer.render(camera, SPLATBUS_BUFFER_OBJECT_ID);
    EXPECT_GT(std::ranges::count_if(pictures.object_id, [](std::uint32_t id) { return id > 0; }), 300);
  }
}

TEST_F(Gltf, WhatIsWrongIsNamed) {
  EXPECT_THAT(words(directory_.path() + "/none.glb"), HasSubstr("No such file"));
  EXPECT_THAT(words(write("")), testing::Not("no error"));
  EXPECT_THAT(words(write("not a glTF file at all, only words")), testing::Not("no error"));
  EXPECT_THAT(broken(R"("count": 4)", R"("count": 400)"),
              testing::AllOf(HasSubstr("accessor 0"), HasSubstr("reach out")));
  EXPECT_THAT(broken(R"("count": 4)", R"("count": 4000000000)"), HasSubstr("accessor 0"));
  EXPECT_THAT(broken(R"("count": 4)", R"("count": 3)"), HasSubstr("index 3 of 3 vertices"));
  EXPECT_THAT(broken(R"("type": "VEC3")", R"("type": "VEC2")"), HasSubstr("3 components"));
  EXPECT_THAT(broken(R"("byteOffset": 48, "byteLength": 12)", R"("byteOffset": 48, "byteLength": 1200)"),
              HasSubstr("accessor 1"));
  EXPECT_THAT(broken(R"("children": [1, 2])", R"("children": [1, 1])"), HasSubstr("twice"));
  EXPECT_THAT(broken(R"("children": [1, 2])", R"("children": [0])"), HasSubstr("twice"));
  EXPECT_THAT(broken(R"("children": [1, 2])", R"("children": [77])"), HasSubstr("no node 77"));
  EXPECT_THAT(broken(R"("mesh": 0)", R"("mesh": 9)"), HasSubstr("no mesh 9"));
  EXPECT_THAT(broken(R"("material": 0)", R"("material": 5)"), HasSubstr("no material 5"));
  EXPECT_THAT(broken(R"("scale": [0.5, 0.5, 0.5])", R"("scale": [0, 0, 0])"), HasSubstr("flattens"));
  EXPECT_THAT(broken(R"("rotation": [0, 0.7071068, 0, 0.7071068])", R"("rotation": [0, 0, 0, 0])"),
              HasSubstr("node 2 ('far')"));
  EXPECT_THAT(broken(R"("asset": {"version": "2.0"})",
                     R"("asset": {"version": "2.0"}, "extensionsRequired": ["KHR_draco_mesh_compression"])"),
              HasSubstr("KHR_draco_mesh_compression"));
}

TEST_F(Gltf, WhatAFileComesToIsBounded) {
  // Two nodes show one square without normals: 6 corners each, and as many vertices.
  const std::string square = write(glb(square_json(), square_bytes()));
  EXPECT_EQ(words(square, {.vertices = 12, .indices = 12}), "no error");
  EXPECT_THAT(words(square, {.vertices = 11}), testing::AllOf(HasSubstr("node 2 ('far')"), HasSubstr("11 vertices")));
  EXPECT_THAT(words(square, {.indices = 11}), testing::AllOf(HasSubstr("node 2 ('far')"), HasSubstr("11 indices")));
  EXPECT_THAT(words(square, {.file_bytes = 100}), HasSubstr("more than 100 bytes of files"));

  // The same picture of 2 x 2 pixels twice, 16 bytes each when it is decoded.
  const std::string picture =
      R"({"uri": "data:image/png;base64,)"
      "iVBORw0KGgoAAAANSUhEUgAAAAIAAAACCAIAAAD91JpzAAAAC0lEQVR4nGNgQAYAAA4AAamRc7EAAAAASUVORK5CYII="
      R"("})";
  std::string json = square_json();
  json.insert(json.rfind('}'), R"(, "images": [)" + picture + ", " + picture + "]");
  const std::string pictures = write(glb(json, square_bytes()));
  EXPECT_EQ(words(pictures, {.image_bytes = 32}), "no error");
  EXPECT_THAT(words(pictures, {.image_bytes = 31}),
              testing::AllOf(HasSubstr("image 1"), HasSubstr("more than 31 bytes of images")));
}

TEST_F(Gltf, PositionsThatAreNotFiniteAreRefused) {
  std::string bytes = square_bytes();
  const float nan = NAN;
  std::memcpy(bytes.data() + 16, &nan, sizeof(nan));
  EXPECT_THAT(words(write(glb(square_json(), bytes))),
              testing::AllOf(HasSubstr("accessor 0"), HasSubstr("row 1 is not finite")));
}

TEST_F(Gltf, TruncatedAndMutatedFilesNeverCrash) {
  const std::string whole = glb(square_json(), square_bytes());
  for (std::size_t length = 0; length < whole.size(); length += 7) {
    EXPECT_NE(words(write(whole.substr(0, length))), "no error") << length;
  }
  std::mt19937 random(5);
  for (int i = 0; i < 400; ++i) {
    std::string mutated = whole;
    for (int k = 0; k < 3; ++k) mutated[random() % mutated.size()] = static_cast<char>(random());
    static_cast<void>(words(write(mutated)));
  }
}

}  // namespace
}  // namespace splatbus::sim

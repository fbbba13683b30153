#include "wire/convert.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

namespace splatbus {
namespace {

using ::testing::HasSubstr;
using ::testing::ThrowsMessage;

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kInfinity = std::numeric_limits<float>::infinity();

auto refused(const char* reason) {
  return ThrowsMessage<std::runtime_error>(HasSubstr(reason));
}

Camera example_camera() {
  Camera camera = look_at({1, 2, 3}, {0, 0.5F, -1}, 160, 120, 1.0F);
  camera.id = 7;
  camera.role = CameraRole::Probe;
  camera.cx = 81;
  camera.far_m = 55;
  return camera;
}

wire::Camera wire_camera(std::uint32_t width, std::uint32_t height, float fx, float near_m, float far_m,
                         wire::CameraRole role = wire::CameraRole::Input, float qw = 1, float tx = 0) {
  return {1, role, width, height, fx, 10, 5, 5, near_m, far_m, {{qw, 0, 0, 0}, {tx, 0, 0}}};
}

Light example_light() {
  Light light;
  light.generation = 42;
  for (int k = 0; k < 9; ++k) {
    light.ambient_sh[static_cast<std::size_t>(k)] = glm::vec3(10 * k, 10 * k + 1, 10 * k + 2);
  }
  light.sun_direction = {0.6F, 0.8F, 0};
  light.sun_irradiance = {3, 2, 1};
  light.background = {0.1F, 0.2F, 0.3F};
  return light;
}

/// Builds a wire::Light of the given parts; the builder owns it.
const wire::Light* wire_light(flatbuffers::FlatBufferBuilder& builder, const std::vector<float>& ambient,
                              const wire::Vec3* direction, const wire::Vec3* irradiance, const wire::Vec3* background) {
  builder.Clear();
  builder.Finish(wire::CreateLight(builder, 1, builder.CreateVector(ambient), direction, irradiance, background));
  return flatbuffers::GetRoot<wire::Light>(builder.GetBufferPointer());
}

TEST(Convert, CameraComesBack) {
  const Camera camera = example_camera();
  const Camera back = from_wire(to_wire(camera));
  EXPECT_EQ(back.id, camera.id);
  EXPECT_EQ(back.role, camera.role);
  EXPECT_EQ(back.width, camera.width);
  EXPECT_EQ(back.height, camera.height);
  EXPECT_EQ(back.fx, camera.fx);
  EXPECT_EQ(back.fy, camera.fy);
  EXPECT_EQ(back.cx, camera.cx);
  EXPECT_EQ(back.cy, camera.cy);
  EXPECT_EQ(back.near_m, camera.near_m);
  EXPECT_EQ(back.far_m, camera.far_m);
  EXPECT_EQ(back.world_from_camera.translation, camera.world_from_camera.translation);
  EXPECT_NEAR(glm::dot(back.world_from_camera.rotation, camera.world_from_camera.rotation), 1, 1e-6F);
}

TEST(Convert, QuaternionsAreWxyzOnTheWire) {
  const wire::Rigid rigid = to_wire(Rigid{glm::quat(0.5F, -0.5F, 0.5F, 0.5F), {1, 2, 3}});
  EXPECT_EQ(rigid.rotation().w(), 0.5F);
  EXPECT_EQ(rigid.rotation().x(), -0.5F);
  EXPECT_EQ(rigid.translation().z(), 3);
}

TEST(Convert, NearUnitQuaternionsAreNormalisedAndOthersRefused) {
  EXPECT_NEAR(glm::length(from_wire(wire::Rigid({1.005F, 0, 0, 0}, {0, 0, 0})).rotation), 1, 1e-6F);
  EXPECT_THAT([] { (void)from_wire(wire::Rigid({1.5F, 0, 0, 0}, {0, 0, 0}), "seat"); }, refused("seat.rotation"));
  EXPECT_THAT([] { (void)from_wire(wire::Rigid({0, 0, 0, 0}, {0, 0, 0})); }, refused("length 0"));
  EXPECT_THAT([] { (void)from_wire(wire::Rigid({kNan, 0, 0, 0}, {0, 0, 0})); }, refused("rotation"));
  EXPECT_THAT([] { (void)from_wire(wire::Rigid({1, 0, 0, 0}, {0, kInfinity, 0}), "seat"); }, refused("seat.y is inf"));
}

TEST(Convert, CamerasThatCannotBeAreRefused) {
  EXPECT_NO_THROW((void)from_wire(wire_camera(8192, 8192, 10, 0, 5)));
  EXPECT_THAT([] { (void)from_wire(wire_camera(0, 4, 10, 0.1F, 5)); }, refused("camera.width is 0"));
  EXPECT_THAT([] { (void)from_wire(wire_camera(4, 8193, 10, 0.1F, 5)); }, refused("camera.height is 8193"));
  EXPECT_THAT([] { (void)from_wire(wire_camera(4, 4, kNan, 0.1F, 5)); }, refused("camera.fx is nan"));
  EXPECT_THAT([] { (void)from_wire(wire_camera(4, 4, 0, 0.1F, 5)); }, refused("not positive"));
  EXPECT_THAT([] { (void)from_wire(wire_camera(4, 4, 10, 5, 5)); }, refused("not a range of depths"));
  EXPECT_THAT([] { (void)from_wire(wire_camera(4, 4, 10, -1, 5)); }, refused("not a range of depths"));
  EXPECT_THAT([] { (void)from_wire(wire_camera(4, 4, 10, 0.1F, kInfinity)); }, refused("camera.far_m is inf"));
  EXPECT_THAT([] { (void)from_wire(wire_camera(4, 4, 10, 0.1F, 5, static_cast<wire::CameraRole>(4))); },
              refused("camera.role 4 is unknown"));
  EXPECT_THAT([] { (void)from_wire(wire_camera(4, 4, 10, 0.1F, 5, wire::CameraRole::Light, 2)); },
              refused("camera.world_from_camera.rotation"));
  EXPECT_THAT([] { (void)from_wire(wire_camera(4, 4, 10, 0.1F, 5, wire::CameraRole::Light, 1, kNan)); },
              refused("camera.world_from_camera.x is nan"));
}

TEST(Convert, LightLiesColourByColourOnTheWireAndComesBack) {
  const Light light = example_light();
  flatbuffers::FlatBufferBuilder builder;
  builder.Finish(to_wire(builder, light));
  const auto* on_wire = flatbuffers::GetRoot<wire::Light>(builder.GetBufferPointer());
  ASSERT_EQ(on_wire->ambient_sh()->size(), 27U);
  EXPECT_EQ(on_wire->ambient_sh()->Get(4), 40) << "R of coefficient 4";
  EXPECT_EQ(on_wire->ambient_sh()->Get(9 + 4), 41) << "G of coefficient 4";
  const Light back = from_wire(*on_wire);
  EXPECT_EQ(back.generation, light.generation);
  EXPECT_EQ(back.ambient_sh, light.ambient_sh);
  EXPECT_LE(glm::distance(back.sun_direction, light.sun_direction), 1e-6F);
  EXPECT_EQ(back.sun_irradiance, light.sun_irradiance);
  EXPECT_EQ(back.background, light.background);
}

TEST(Convert, LightWithoutSunOrBackgroundIsDark) {
  flatbuffers::FlatBufferBuilder builder;
  const std::vector<float> ambient(27, 0.5F);
  const wire::Vec3 zero(0, 0, 0);
  for (const wire::Vec3* direction : {static_cast<const wire::Vec3*>(nullptr), &zero}) {
    const Light light = from_wire(*wire_light(builder, ambient, direction, nullptr, nullptr));
    EXPECT_EQ(light.sun_irradiance, glm::vec3(0));
    EXPECT_EQ(light.background, glm::vec3(0));
    EXPECT_NEAR(glm::length(light.sun_direction), 1, 1e-6F);
  }
}

TEST(Convert, LightsThatCannotBeAreRefused) {
  flatbuffers::FlatBufferBuilder builder;
  std::vector<float> ambient(27, 0.5F);
  const wire::Vec3 up(0, 1, 0), long_one(0, 3, 0), bright(1, 1, 1), negative(1, -1, 1), broken(0, kNan, 0);
  const auto light = [&](const wire::Vec3* direction, const wire::Vec3* irradiance, const wire::Vec3* background) {
    return [&builder, &ambient, direction, irradiance, background] {
      (void)from_wire(*wire_light(builder, ambient, direction, irradiance, background));
    };
  };
  EXPECT_NO_THROW(light(&up, &bright, &bright)());
  EXPECT_THAT(light(&long_one, &bright, &bright), refused("light.sun_direction (0, 3, 0) has length 3"));
  EXPECT_THAT(light(nullptr, &bright, &bright), refused("light.sun_direction"));
  EXPECT_THAT(light(&broken, &bright, &bright), refused("light.sun_direction.y is nan"));
  EXPECT_THAT(light(&up, &negative, &bright), refused("light.sun_irradiance"));
  EXPECT_THAT(light(&up, &bright, &broken), refused("light.background.y is nan"));
  ambient[20] = kInfinity;
  EXPECT_THAT(light(&up, &bright, &bright), refused("light.ambient_sh[20] is inf"));
  for (const std::size_t size : {std::size_t{0}, std::size_t{26}, std::size_t{28}}) {
    ambient.assign(size, 0);
    EXPECT_THAT(light(&up, &bright, &bright), refused("light.ambient_sh has"));
  }
}

Light light_of(std::vector<LightSource> sources) {
  flatbuffers::FlatBufferBuilder builder;
  Light light{.sun_irradiance = glm::vec3(1), .sources = std::move(sources), .sun_depth_version = 77};
  builder.Finish(to_wire(builder, light));
  return from_wire(*flatbuffers::GetRoot<wire::Light>(builder.GetBufferPointer()));
}

const LightSource kSpot{.id = 4,
                        .kind = LightKind::Spot,
                        .casts_shadow = false,
                        .position = {1, 2, 3},
                        .direction = {0, -1, 0},
                        .intensity = {4, 5, 6},
                        .range_m = 7,
                        .cos_inner = 0.9F,
                        .cos_outer = 0.8F,
                        .depth_version = 1ULL << 60U};

TEST(Convert, LightSourcesComeBack) {
  const LightSource point{.id = 0xFFFFFFFF, .position = {-1, 0, 2}, .intensity = {1, 0, 0}, .range_m = 3};
  const LightSource directional{
      .id = 1, .kind = LightKind::Directional, .direction = {0.6F, 0.8F, 0}, .intensity = {0, 1, 0}, .range_m = 0};
  const std::vector<LightSource> sources = {directional, kSpot, point};
  const Light back = light_of(sources);
  EXPECT_EQ(back.sources, sources);
  EXPECT_EQ(back.sun_depth_version, 77U);
}

TEST(Convert, LightSourcesThatCannotBeAreRefused) {
  const auto spoilt = [](auto&& spoil) {
    return [spoil] {
      LightSource source = kSpot;
      spoil(source);
      (void)light_of({source});
    };
  };
  EXPECT_THAT(spoilt([](LightSource& s) { s.id = 0; }), refused("light.sources, 0: 0 is the sun"));
  EXPECT_THAT(spoilt([](LightSource& s) { s.kind = static_cast<LightKind>(3); }), refused("an unknown kind"));
  EXPECT_THAT(spoilt([](LightSource& s) { s.position.y = kNan; }), refused("light.sources, 4.position.y"));
  EXPECT_THAT(spoilt([](LightSource& s) { s.intensity.z = -1; }), refused("light.sources, 4.intensity"));
  EXPECT_THAT(spoilt([](LightSource& s) { s.direction = {0, -2, 0}; }), refused("direction is not of length 1"));
  for (const float range_m : {0.0F, -1.0F, kNan, kInfinity}) {
    EXPECT_THAT(spoilt([=](LightSource& s) { s.range_m = range_m; }), refused("range_m is not above 0"));
  }
  EXPECT_THAT(spoilt([](LightSource& s) { s.cos_outer = s.cos_inner; }), refused("do not make a cone"));
  EXPECT_THAT(spoilt([](LightSource& s) { s.cos_inner = 1.5F; }), refused("do not make a cone"));
  EXPECT_THAT(spoilt([](LightSource& s) { s.cos_outer = kNan; }), refused("do not make a cone"));
  EXPECT_THAT([] { (void)light_of({kSpot, kSpot}); }, refused("light.sources: 4 after 4"));
  EXPECT_THAT([] { (void)light_of(std::vector<LightSource>(33, kSpot)); }, refused("33 lights, at most 32"));
}

TEST(Convert, ObjectsComeBack) {
  flatbuffers::FlatBufferBuilder builder;
  ObjectTransforms objects = {{3, Rigid{glm::quat(0, 1, 0, 0), {1, 2, 3}}}, {9, {}}, {0xFFFFFFFF, {}}};
  objects.at(9).scale = 2.5F;
  objects.at(9).emissive = true;
  objects.at(0xFFFFFFFF).modelled = false;
  builder.Finish(to_wire(builder, objects));
  const auto* on_wire =
      flatbuffers::GetRoot<flatbuffers::Vector<const wire::ObjectTransform*>>(builder.GetBufferPointer());
  const ObjectTransforms back = from_wire(on_wire);
  EXPECT_EQ(back, objects);
  EXPECT_TRUE(from_wire(static_cast<decltype(on_wire)>(nullptr)).empty());
}

TEST(Convert, ObjectsThatCannotBeAreRefused) {
  flatbuffers::FlatBufferBuilder builder;
  const auto objects = [&builder](const std::vector<wire::ObjectTransform>& structs) {
    builder.Clear();
    builder.Finish(builder.CreateVectorOfStructs(structs));
    return from_wire(
        flatbuffers::GetRoot<flatbuffers::Vector<const wire::ObjectTransform*>>(builder.GetBufferPointer()));
  };
  const wire::Rigid good({1, 0, 0, 0}, {0, 0, 0}), bad({0, 0, 0, 0}, {0, 0, 0});
  constexpr auto none = static_cast<wire::ObjectFlags>(0);
  EXPECT_THAT([&] { (void)objects({{5, good, 1, none}, {5, good, 1, none}}); }, refused("object 5 has two transforms"));
  EXPECT_THAT([&] { (void)objects({{5, good, 1, none}, {6, bad, 1, none}}); }, refused("object 6.rotation"));
  for (const float scale : {0.0F, -1.0F, 1e-40F, kNan, kInfinity}) {
    EXPECT_THAT([&] { (void)objects({{7, good, scale, none}}); }, refused("object 7.scale is"));
  }
}

}  // namespace
}  // namespace splatbus

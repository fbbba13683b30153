// What an engine gets wrong is refused in words that name it, and the rest goes on.
#include <gmock/gmock.h>

#include <array>
#include <functional>
#include <limits>

#include "sdk_fixture.h"
#include "wire/convert.h"

namespace splatbus::engine_test {
namespace {

using testing::AllOf;
using testing::HasSubstr;

constexpr float kInfinity = std::numeric_limits<float>::infinity();

splatbus_object object(std::uint32_t id) {
  return {id, {{1, 0, 0, 0}, {0, 0, 0}}, 1, 0};
}

splatbus_light_source light_source(std::uint32_t id, std::uint32_t kind) {
  return {.id = id,
          .kind = kind,
          .casts_shadow = 1,
          .position = {1, 2, 3},
          .direction = {0, -1, 0},
          .intensity = {4, 5, 6},
          .range_m = 7,
          .cos_inner = 0.9F,
          .cos_outer = 0.7F,
          .depth_version = 8};
}

class SdkRefusal : public SdkTest {
 protected:
  SdkRefusal() : frames_(connect("tester"), {"engine/frame"}), engine_(open()) {
    EXPECT_TRUE(frames_.wait_connected(patience));
  }

  /// The words for a frame of two objects, 4 and 7, that `spoil` makes wrong. It is not published, and the next frame
  /// is.
  std::string words(const std::function<void(OwnedFrame&)>& spoil, const splatbus_camera& camera = small_camera()) {
    OwnedFrame bad = next_frame(camera);
    spoil(bad);
    bad.refresh();
    return refused(bad.frame);
  }
  std::string refused(const splatbus_frame& frame) {
    EXPECT_EQ(splatbus_engine_submit(engine_.get(), &frame), SPLATBUS_ERROR_ARGUMENT);
    std::string error = splatbus_engine_last_error(engine_.get());
    EXPECT_THAT(error, HasSubstr("frame " + std::to_string(frame.frame)));
    expect_published(next_frame(small_camera()).frame);
    return error;
  }

  OwnedFrame next_frame(const splatbus_camera& camera) {
    OwnedFrame owned(camera);
    owned.frame.frame = ++frame_;
    owned.frame.time_s = 0.1 * static_cast<double>(frame_);
    owned.objects = {object(4), object(7)};
    owned.refresh();
    return owned;
  }

  /// What was published, as its readers take it.
  splatbus::SceneState expect_published(const splatbus_frame& frame) {
    EXPECT_EQ(splatbus_engine_submit(engine_.get(), &frame), SPLATBUS_OK) << splatbus_engine_last_error(engine_.get());
    const auto message = frames_.receive(patience);
    if (!message) throw std::runtime_error("nothing was published");
    EXPECT_EQ(message->root<wire::EngineFrame>().scene()->frame(), frame.frame);
    return from_wire(*message->root<wire::EngineFrame>().scene());
  }

  bus::Subscriber frames_;
  Engine engine_;
  std::uint64_t frame_ = 10;
};

TEST_F(SdkRefusal, Cameras) {
  EXPECT_THAT(words([](auto& f) { f.frame.camera.world_from_camera.translation[1] = kNan; }),
              AllOf(HasSubstr("camera 3"), HasSubstr("world_from_camera.translation is not finite")));
  EXPECT_THAT(words([](auto& f) { f.frame.camera.world_from_camera.rotation_wxyz[0] = 2; }),
              HasSubstr("world_from_camera.rotation_wxyz is not a unit quaternion (norm 2)"));
  EXPECT_THAT(words([](auto& f) { f.frame.camera.width = 0; }), HasSubstr("0 x 6 pixels"));
  EXPECT_THAT(words([](auto& f) { f.frame.camera.role = 9; }), HasSubstr("no such role"));
  EXPECT_THAT(words([](auto& f) { f.frame.camera.far_m = 0; }), HasSubstr("near_m < far_m"));
}

TEST_F(SdkRefusal, LightCameras) {
  const auto light = [&](const std::function<void(splatbus_camera&)>& spoil) {
    splatbus_camera camera = small_camera(6, SPLATBUS_ROLE_LIGHT);
    spoil(camera);
    return words([](OwnedFrame& f) { f.images[0].buffer = SPLATBUS_BUFFER_LIGHT_DEPTH; }, camera);
  };
  EXPECT_THAT(light([](auto& c) { c.fx = 0; }), AllOf(HasSubstr("camera 6 (role 3)"), HasSubstr("fx and fy")));
  EXPECT_THAT(light([](auto& c) { c.fy = -4; }), HasSubstr("fx and fy must be above 0"));
  EXPECT_THAT(light([](auto& c) { c.fx = kNan; }), HasSubstr("fx, fy, cx, cy are not all finite"));
  EXPECT_THAT(light([](auto& c) { c.near_m = c.far_m; }), HasSubstr("0 <= near_m < far_m"));
  EXPECT_THAT(light([](auto& c) { c.far_m = kInfinity; }), HasSubstr("near_m and far_m are not both finite"));
  EXPECT_THAT(light([](auto& c) { c.world_from_camera.rotation_wxyz[3] = kNan; }),
              HasSubstr("world_from_camera.rotation_wxyz is not finite"));
}

TEST_F(SdkRefusal, Images) {
  EXPECT_THAT(words([](auto& f) { f.images[0].bytes -= 4; }),
              HasSubstr("color: 188 bytes, where 8 x 6 pixels take 192"));
  EXPECT_THAT(words([](auto& f) { f.images[0].data = nullptr; }), HasSubstr("color: data is NULL"));
  EXPECT_THAT(words([](auto& f) { f.images[0].memory = 2; }),
              HasSubstr("color: its memory is 2, which does not exist"));
  EXPECT_THAT(words([](auto& f) { f.images[0].memory = SPLATBUS_MEMORY_CUDA; }), HasSubstr("CUDA"));
  EXPECT_THAT(words([](auto& f) { f.images[0].buffer = 3; }), HasSubstr("0x3 is not one known buffer"));
  EXPECT_THAT(words([](auto& f) { f.images.push_back(f.images[0]); }), HasSubstr("color was given twice"));
  OwnedFrame nowhere = next_frame(small_camera());
  nowhere.frame.images = nullptr;
  EXPECT_THAT(refused(nowhere.frame), HasSubstr("images is NULL"));
  EXPECT_THAT(words([](auto& f) { f.images[0].buffer = SPLATBUS_BUFFER_LIGHT_DEPTH; }),
              HasSubstr("only a camera of role light"));
}

TEST_F(SdkRefusal, Lights) {
  EXPECT_THAT(words([](auto& f) { f.frame.light.ambient_sh[20] = kNan; }),
              HasSubstr("light: ambient_sh is not finite"));
  EXPECT_THAT(words([](auto& f) { f.frame.light.ambient_sh[9] = -0.1F; }),
              AllOf(HasSubstr("light: ambient_sh[9]"), HasSubstr("-0.1, below 0")));
  EXPECT_THAT(words([](auto& f) { f.frame.light.sun_direction[1] = 0; }),
              HasSubstr("light: sun_direction is not unit (norm 0)"));
  EXPECT_THAT(words([](auto& f) { f.frame.light.sun_direction[0] = kInfinity; }),
              HasSubstr("light: sun_direction is not finite"));
  EXPECT_THAT(words([](auto& f) { f.frame.light.sun_irradiance[2] = kInfinity; }),
              HasSubstr("light: sun_irradiance is not finite"));
  EXPECT_THAT(words([](auto& f) { f.frame.light.sun_irradiance[2] = -1; }),
              HasSubstr("light: sun_irradiance[2] is -1, below 0"));
  EXPECT_THAT(words([](auto& f) { f.frame.light.background[0] = kNan; }), HasSubstr("light: background is not finite"));
  EXPECT_THAT(words([](auto& f) { f.frame.light.background[1] = -0.5F; }),
              HasSubstr("light: background[1] is -0.5, below 0"));

  // Higher coefficients have either sign.
  OwnedFrame dark = next_frame(small_camera());
  dark.frame.light.ambient_sh[0] = dark.frame.light.ambient_sh[9] = dark.frame.light.ambient_sh[18] = 1;
  dark.frame.light.ambient_sh[1] = dark.frame.light.ambient_sh[26] = -0.3F;
  expect_published(dark.frame);
}

/// Of a directional light 2, a point light 3 and a spot light 5.
TEST_F(SdkRefusal, LightsBesidesTheSun) {
  using Sources = std::vector<splatbus_light_source>;
  const Sources good{light_source(2, SPLATBUS_LIGHT_DIRECTIONAL), light_source(3, SPLATBUS_LIGHT_POINT),
                     light_source(5, SPLATBUS_LIGHT_SPOT)};
  const auto spoilt = [&](const std::function<void(Sources&)>& spoil) {
    Sources sources = good;
    spoil(sources);
    return words([&](auto& f) {
      f.frame.light.sources = sources.data();
      f.frame.light.source_count = sources.size();
    });
  };
  EXPECT_THAT(spoilt([](auto& s) { s[1].id = 0; }), HasSubstr("light 0: 0 is the sun"));
  EXPECT_THAT(spoilt([](auto& s) { s[2].id = 2; }), HasSubstr("light 2 was given twice"));
  EXPECT_THAT(spoilt([](auto& s) { s[1].kind = 3; }), HasSubstr("light 3: 3 is not a kind of light"));
  EXPECT_THAT(spoilt([](auto& s) { s[1].intensity[2] = kNan; }), HasSubstr("light 3: intensity is not finite"));
  EXPECT_THAT(spoilt([](auto& s) { s[0].intensity[0] = -1e-3F; }), HasSubstr("light 2: intensity is below 0"));
  EXPECT_THAT(spoilt([](auto& s) { s[0].direction[1] = -2; }), HasSubstr("light 2: direction is not unit (norm 2)"));
  EXPECT_THAT(spoilt([](auto& s) { s[2].direction[1] = 0; }), HasSubstr("light 5: direction is not unit (norm 0)"));
  EXPECT_THAT(spoilt([](auto& s) { s[2].direction[0] = kInfinity; }), HasSubstr("light 5: direction is not finite"));
  EXPECT_THAT(spoilt([](auto& s) { s[1].position[0] = kNan; }), HasSubstr("light 3: position is not finite"));
  EXPECT_THAT(spoilt([](auto& s) { s[1].range_m = 0; }), HasSubstr("light 3: range_m is 0, not above 0"));
  EXPECT_THAT(spoilt([](auto& s) { s[2].range_m = kNan; }), HasSubstr("light 5: range_m is nan, not above 0"));
  EXPECT_THAT(spoilt([](auto& s) { s[1].range_m = kInfinity; }), HasSubstr("light 3: range_m is inf"));
  EXPECT_THAT(spoilt([](auto& s) { s[2].cos_inner = 0.7F; }),
              HasSubstr("light 5: cos_outer 0.7 and cos_inner 0.7 do not make a cone"));
  EXPECT_THAT(spoilt([](auto& s) { s[2].cos_inner = 1.5F; }), HasSubstr("light 5: cos_outer 0.7 and cos_inner 1.5"));
  EXPECT_THAT(spoilt([](auto& s) { s[2].cos_outer = -1.5F; }), HasSubstr("light 5: cos_outer -1.5"));
  EXPECT_THAT(spoilt([](auto& s) { s[2].cos_outer = kNan; }), HasSubstr("light 5: cos_outer nan"));
  const auto crowd = [](std::uint32_t count) {
    Sources sources;
    for (std::uint32_t id = count; id > 0; --id) sources.push_back(light_source(id, SPLATBUS_LIGHT_POINT));
    return sources;
  };
  EXPECT_THAT(spoilt([&](auto& s) { s = crowd(SPLATBUS_MAX_LIGHTS + 1); }),
              HasSubstr("light: 33 sources, at most 32 are allowed"));
  EXPECT_THAT(words([](auto& f) { f.frame.light.source_count = 1; }), HasSubstr("light: sources is NULL"));

  // What does not count for a kind may be anything.
  Sources most = crowd(SPLATBUS_MAX_LIGHTS);
  most[0].kind = SPLATBUS_LIGHT_DIRECTIONAL;
  most[0].range_m = most[0].position[2] = most[0].cos_inner = kNan;
  most[1].direction[1] = most[1].cos_outer = kNan;
  OwnedFrame bright = next_frame(small_camera());
  bright.frame.light.sources = most.data();
  bright.frame.light.source_count = most.size();
  const splatbus::Light read = expect_published(bright.frame).light;
  EXPECT_EQ(read, splatbus::Light(read)) << "nothing in it is no number";
}

TEST_F(SdkRefusal, MapsThatNoLightHas) {
  std::vector<splatbus_light_source> sources{
      light_source(2, SPLATBUS_LIGHT_DIRECTIONAL), light_source(3, SPLATBUS_LIGHT_POINT),
      light_source(5, SPLATBUS_LIGHT_SPOT), light_source(6, SPLATBUS_LIGHT_POINT)};
  sources[3].casts_shadow = 0;
  const std::vector<float> depth(48, 1);
  const auto map_of = [&](std::uint32_t light_id, std::uint32_t light_map) {
    OwnedFrame map = next_frame(small_camera(6, SPLATBUS_ROLE_LIGHT));
    map.images = {{SPLATBUS_BUFFER_LIGHT_DEPTH, depth.data(), 192, SPLATBUS_MEMORY_HOST}};
    map.refresh();
    map.frame.light.sources = sources.data();
    map.frame.light.source_count = sources.size();
    map.frame.light_id = light_id;
    map.frame.light_map = light_map;
    return map;
  };
  EXPECT_THAT(refused(map_of(4, 0).frame), HasSubstr("camera 6 (role 3): light_id is 4, which is not a light of the"));
  EXPECT_THAT(refused(map_of(6, 0).frame), HasSubstr("light 6 casts no shadow: it has no depth maps"));
  EXPECT_THAT(refused(map_of(3, 6).frame), HasSubstr("light_map is 6, where light 3 has 0 to 5"));
  EXPECT_THAT(refused(map_of(5, 1).frame), HasSubstr("light_map is 1, where light 5 has 0 to 0"));
  EXPECT_THAT(refused(map_of(0, 256).frame), HasSubstr("light_map is 256, where 255 is the last"));
  for (const auto& [light_id, light_map] : {std::pair{0U, 3U}, {2U, 255U}, {3U, 5U}, {5U, 0U}})
    expect_published(map_of(light_id, light_map).frame);
}

TEST_F(SdkRefusal, Objects) {
  EXPECT_THAT(words([](auto& f) { f.objects[1].world_from_object.translation[2] = kInfinity; }),
              HasSubstr("object 7: world_from_object.translation is not finite"));
  EXPECT_THAT(words([](auto& f) { f.objects[1].world_from_object.rotation_wxyz[1] = kNan; }),
              HasSubstr("object 7: world_from_object.rotation_wxyz is not finite"));
  EXPECT_THAT(words([](auto& f) { f.objects[0].world_from_object.rotation_wxyz[0] = 0; }),
              HasSubstr("object 4: world_from_object.rotation_wxyz is not a unit quaternion (norm 0)"));
  EXPECT_THAT(words([](auto& f) { f.objects[0].world_from_object.rotation_wxyz[2] = 3e38F; }),
              HasSubstr("object 4: world_from_object.rotation_wxyz is not a unit quaternion (norm inf)"));
  for (const float scale : {0.0F, -1.0F, kNan, kInfinity}) {
    EXPECT_THAT(words([&](auto& f) { f.objects[1].scale = scale; }), HasSubstr("object 7: scale is ")) << scale;
  }
  EXPECT_THAT(words([](auto& f) { f.objects[1].flags = 5; }), HasSubstr("object 7: 0x5 are not flags of an object"));
  EXPECT_THAT(words([](auto& f) { f.objects[0].id = 0; }), HasSubstr("object 0"));
  EXPECT_THAT(words([](auto& f) { f.objects[1].id = 4; }), HasSubstr("object 4 was given twice"));
  EXPECT_THAT(words([](auto& f) {
                f.objects = {object(0xFFFFFFFF), object(2), object(9), object(0xFFFFFFFF)};
              }),
              HasSubstr("object 4294967295 was given twice"));
  OwnedFrame nowhere = next_frame(small_camera());
  nowhere.frame.objects = nullptr;
  EXPECT_THAT(refused(nowhere.frame), HasSubstr("objects is NULL"));
}

TEST_F(SdkRefusal, MoreObjectsThanTheBound) {
  const auto fill = [](OwnedFrame& f, std::uint32_t count) {
    f.objects.clear();
    for (std::uint32_t i = 0; i < count; ++i) f.objects.push_back(object(count - i));
    f.refresh();
  };
  EXPECT_THAT(words([&](auto& f) { fill(f, SPLATBUS_MAX_OBJECTS + 1); }),
              HasSubstr(std::to_string(SPLATBUS_MAX_OBJECTS + 1) + " objects, at most " +
                        std::to_string(SPLATBUS_MAX_OBJECTS) + " are allowed"));
  OwnedFrame most = next_frame(small_camera());
  fill(most, SPLATBUS_MAX_OBJECTS);
  expect_published(most.frame);
}

TEST_F(SdkRefusal, OfFramesThatAreSubmittedTogetherAll) {
  const OwnedFrame good = next_frame(small_camera());
  OwnedFrame bad = next_frame(small_camera());
  bad.frame.time_s = good.frame.time_s - 0.05;
  const std::array together{good.frame, bad.frame};
  EXPECT_EQ(splatbus_engine_submit_all(engine_.get(), together.data(), 2), SPLATBUS_ERROR_ARGUMENT);
  EXPECT_THAT(splatbus_engine_last_error(engine_.get()), AllOf(HasSubstr("frame 12"), HasSubstr("runs backwards")));
  expect_published(next_frame(small_camera()).frame);
}

TEST_F(SdkRefusal, WhatRunsBackwards) {
  const OwnedFrame first = next_frame(small_camera());
  expect_published(first.frame);

  OwnedFrame earlier = next_frame(small_camera());
  earlier.frame.frame = first.frame.frame - 1;
  EXPECT_THAT(refused(earlier.frame), HasSubstr("frame runs backwards: the last one was 11"));

  EXPECT_THAT(words([](auto& f) { f.frame.time_s = 0.25; }), HasSubstr("time_s runs backwards: 0.25 after "));
  EXPECT_THAT(words([](auto& f) { f.frame.time_s = kNan; }), HasSubstr("time_s is not finite"));

  // Many cameras of one frame, and what was refused counts for nothing.
  const OwnedFrame again = next_frame(small_camera());
  expect_published(again.frame);
  expect_published(again.frame);
  OwnedFrame far = next_frame(small_camera());
  far.frame.frame = 1'000'000;
  far.frame.time_s = 1e9;
  far.frame.light.background[0] = -1;
  EXPECT_THAT(refused(far.frame), HasSubstr("background"));

  // Another handle has a clock of its own.
  const Engine other = open("other");
  OwnedFrame start(small_camera());
  start.frame.frame = 0;
  start.frame.time_s = 0;
  EXPECT_EQ(splatbus_engine_submit(other.get(), &start.frame), SPLATBUS_OK);
}

}  // namespace
}  // namespace splatbus::engine_test

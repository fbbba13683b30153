// Many objects, their scales and flags, on their way to viewers.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "scene_expectations.h"
#include "stream/delta_selection.h"
#include "stream/scene_codec.h"
#include "toy_server.h"

namespace splatbus::stream {
namespace {

using test::expect_scene_near;
using test::join;
using test::send;
using test::ToyServer;

TEST(SceneObjects, ScaleAndFlagsFollowAndCostNothingWhileTheyRest) {
  ToyServer server(51);
  server.scene.objects[1];
  const std::size_t plain = server.change_scene().at(0).packet.size();
  server.scene.objects.erase(1);
  (void)server.change_scene();
  Replica replica;
  join(server.stream, replica);
  std::mt19937 random(5);
  for (int frame = 0; frame < 300; ++frame) {
    ObjectTransform& object = server.scene.objects[1 + random() % 5];
    if (random() % 3 == 0) object.scale = std::exp(std::normal_distribution<float>(0, 2)(random));
    if (random() % 3 == 0) object.emissive = !object.emissive;
    if (random() % 3 == 0) object.modelled = !object.modelled;
    object.rigid.translation.x += 0.1F;
    if (random() % 10 == 0) server.scene.objects.erase(1 + random() % 5);
    send(server.change_scene(), replica);
    expect_scene_near(replica.scene(), server.scene);
    if (HasFailure()) return;
  }
  // 1 is exact, and neither travels where it is as it was.
  ToyServer other(52);
  other.scene.objects[1].scale = 1;
  EXPECT_EQ(other.change_scene().at(0).packet.size(), plain);
  Replica still;
  join(other.stream, still);
  EXPECT_EQ(still.scene().objects.at(1).scale, 1.0F);
}

TEST(SceneObjects, AScaleThatIsNoneIsRefusedByName) {
  ToyServer server(53);
  for (const float scale : {0.0F, -1.0F, std::nanf(""), std::numeric_limits<float>::infinity()}) {
    server.scene.objects[4].scale = scale;
    try {
      (void)quantize_scene(server.scene);
      FAIL() << scale;
    } catch (const StreamError& error) {
      EXPECT_NE(std::string(error.what()).find("object 4: scale"), std::string::npos) << error.what();
    }
  }
}

TEST(SceneObjects, OfTenThousandThoseThatMoveAreSent) {
  ToyServer server(54);
  for (std::uint32_t id = 1; id <= 10'000; ++id) {
    server.scene.objects[7 * id].rigid.translation = {static_cast<float>(id % 100), 0, static_cast<float>(id / 100)};
  }
  (void)server.change_scene();
  Replica replica;
  join(server.stream, replica);
  for (int frame = 0; frame < 5; ++frame) {
    for (std::uint32_t k = 1; k <= 100; ++k) {
      Rigid& object = server.scene.objects[700 * k].rigid;
      object.translation += glm::vec3(0.03F, 0.01F, -0.02F);
      object.rotation = glm::angleAxis(0.1F * static_cast<float>(frame + 1), glm::vec3(0, 1, 0));
    }
    const auto packets = server.change_scene();
    ASSERT_EQ(packets.size(), 1U);
    EXPECT_LE(packets[0].bytes(), 130U + 100U * 15);
    send(packets, replica);
    expect_scene_near(replica.scene(), server.scene);
    if (HasFailure()) return;
  }
}

// The worst that an engine can do: as many objects as there may be, all of them other ones, as far apart as can be,
// with all parts, from one corner of the world to the other.
TEST(SceneObjects, AllThatThereMayBeFitAPacketWhateverTheyDo) {
  ToyServer server(55);
  constexpr std::uint32_t kApart = 0xFFFFFFFFU / kMaxObjects;
  const auto put = [&](std::uint32_t shift, float metres) {
    server.scene.objects.clear();
    for (std::uint32_t k = 0; k < kMaxObjects; ++k) {
      ObjectTransform& object = server.scene.objects[k * kApart + shift];
      object.rigid.translation = glm::vec3(metres);
      object.rigid.rotation = glm::angleAxis(metres, glm::vec3(0, 1, 0));
      object.scale = metres > 0 ? 1e18F : 1e-18F;
      object.emissive = metres > 0;
    }
    const auto packets = server.change_scene();
    ASSERT_EQ(packets.size(), 1U);
    EXPECT_GT(packets[0].packet.size(), 500'000U);
    EXPECT_LE(packets[0].packet.size(), kMaxPacketBytes);
    ASSERT_TRUE(server.stream.ready());
  };
  put(1, 1e9F);
  Replica replica;
  join(server.stream, replica);
  for (const std::uint32_t shift : {1U, 3U, 0U}) {
    put(shift, shift == 1 ? -1e9F : 1e9F);
    EXPECT_EQ(server.stream.held().scene.version, server.scene.version);
  }
  Replica late;
  join(server.stream, late);
  EXPECT_EQ(late.scene().objects.size(), kMaxObjects);
  EXPECT_EQ(late.scene().objects.begin()->first, 0U);
}

// A Gaussian of an object that is three times as large covers nine times the area, three times as far from the middle.
TEST(SceneObjects, ShareOfThePictureGrowsWithTheScale) {
  const StreamLayout layout;
  QuantizedGaussians one(layout, 1);
  one.object_id = {6};
  const auto set = [&](Attribute attribute, int channel, float value) {
    const AttributeChannels& a = layout.at(attribute);
    one.channels[a.first + channel][0] =
        static_cast<std::int32_t>(std::lround((value - a.quantizer.offset) / a.quantizer.step));
  };
  for (int axis = 0; axis < 3; ++axis) set(Attribute::LogScale, axis, -5);
  set(Attribute::Opacity, 0, 1);
  const std::vector<Camera> cameras{look_at({0, 0, 5}, {0, 0, 0}, 64, 64, 1)};
  ObjectTransforms objects{{6, {}}};
  const float plain = picture_share(one, layout, cameras, objects)[0];
  objects[6].scale = 3;
  EXPECT_NEAR(picture_share(one, layout, cameras, objects)[0], 9 * plain, 1e-3F * plain);
  set(Attribute::Mean, 0, 1.5F);  // at 4.5 m it is outside the picture
  EXPECT_LT(picture_share(one, layout, cameras, objects)[0], plain);
}

}  // namespace
}  // namespace splatbus::stream

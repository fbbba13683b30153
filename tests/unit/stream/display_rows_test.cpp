#include "stream/display_rows.h"

#include <gtest/gtest.h>

#include <map>
#include <set>

#include "gaussians/transfer.h"
#include "shown_replica.h"
#include "toy_server.h"

namespace splatbus::stream {
namespace {

using test::ShownReplica;
using test::ToyServer;

glm::vec3 decoded(std::uint32_t rgb9e5) {
  const float step = std::ldexp(1.0F, static_cast<int>(rgb9e5 >> 27) - 24);
  return step * glm::vec3(rgb9e5 & 511U, rgb9e5 >> 9 & 511U, rgb9e5 >> 18 & 511U);
}

float largest(const glm::vec3& v) {
  return std::max({v.x, v.y, v.z});
}

TEST(SharedExponent, IsWithinHalfAStepOfTheLargest) {
  std::mt19937 random(1);
  std::uniform_real_distribution<float> octave(-14, 16), uniform(0, 1);
  for (int k = 0; k < 10000; ++k) {
    const float scale = std::exp2(octave(random));
    const glm::vec3 color(std::min(scale * uniform(random), 65408.0F), scale * 0.5F * uniform(random), 0);
    const glm::vec3 error = glm::abs(decoded(shared_exponent_rgb(color)) - color);
    EXPECT_LE(largest(error), std::max(largest(color) / 511, std::ldexp(1.0F, -25))) << color.x << " " << color.y;
  }
}

TEST(SharedExponent, BoundsWhatItCannotHold) {
  EXPECT_EQ(decoded(shared_exponent_rgb({0, 0, 0})), glm::vec3(0));
  EXPECT_EQ(decoded(shared_exponent_rgb({1, 0.5F, 0.25F})), glm::vec3(1, 0.5F, 0.25F));
  EXPECT_EQ(decoded(shared_exponent_rgb({1e9F, -1, NAN})), glm::vec3(65408, 0, 0));
  EXPECT_EQ(decoded(shared_exponent_rgb({INFINITY, 0, 1e-9F})), glm::vec3(65408, 0, 0));
  // It would round to 512 of the exponent's steps.
  EXPECT_EQ(decoded(shared_exponent_rgb({0.99999F, 0, 0})), glm::vec3(1, 0, 0));
}

/// What a page does with rows: a GPU's memory, and how much went there.
class Gpu {
 public:
  explicit Gpu(Replica& replica) : rows_(replica) {}

  void follow(std::size_t most = 1000) {
    uploaded = recolored = 0;
    std::vector<std::uint32_t> rows, colors;
    std::vector<DisplayRecord> records;
    do {
      rows_.take_records(most, rows, records);
      EXPECT_LE(rows.size(), most);
      memory.resize(rows_.capacity());
      for (std::size_t k = 0; k < rows.size(); ++k) memory.at(rows[k]) = records[k];
      uploaded += rows.size();
    } while (!rows.empty());
    EXPECT_EQ(rows_.unsent(), 0U);
    do {
      rows_.take_colors(most, rows, colors);
      for (std::size_t k = 0; k < rows.size(); ++k) memory.at(rows[k]).color = colors[k];
      recolored += rows.size();
    } while (!rows.empty());
  }
  [[nodiscard]] DisplayRows& rows() { return rows_; }

  std::vector<DisplayRecord> memory;
  std::size_t uploaded = 0, recolored = 0;

 private:
  DisplayRows rows_;
};

std::array<float, 3> key_of(const GaussiansView& view, std::size_t i) {
  return {view.plane(0)[i], view.plane(1)[i], view.plane(2)[i]};
}

/// Compares the GPU's memory with the floats that the rasteriser reads of another replica of the same packets.
void expect_shows(Gpu& gpu, ShownReplica& shown) {
  const GaussiansView view = shown.view();
  std::multimap<std::array<float, 3>, std::size_t> columns;
  for (std::size_t i = 0; i < view.count; ++i) columns.emplace(key_of(view, i), i);
  const auto& transforms = gpu.rows().transforms();
  std::map<std::uint32_t, std::uint32_t> index_of;  // of object ids
  std::size_t used = 0;
  for (const DisplayRecord& record : gpu.memory) {
    if ((record.opacity_object & 0xFF) == 0 && !columns.contains(record.mean)) continue;  // free
    const auto found = columns.find(record.mean);
    ASSERT_NE(found, columns.end());
    const std::size_t i = found->second;
    columns.erase(found);
    ++used;
    const auto float_at = [&](int channel) { return view.plane(channel)[i]; };
    for (int c = 0; c < 3; ++c) {
      EXPECT_NEAR(kLogScaleStep * static_cast<float>(record.log_scale[static_cast<std::size_t>(c)]), float_at(3 + c),
                  kLogScaleStep);
    }
    EXPECT_NEAR(static_cast<float>(record.opacity_object & 0xFF) / 255, 1 / (1 + std::exp(-float_at(10))), 0.0011F);
    const glm::vec3 v = kRotationStep_rad * glm::vec3(record.rotation[0], record.rotation[1], record.rotation[2]);
    const glm::quat q = glm::length(v) > 0 ? glm::angleAxis(glm::length(v), glm::normalize(v)) : glm::quat(1, 0, 0, 0);
    const glm::quat expected(float_at(6), float_at(7), float_at(8), float_at(9));
    EXPECT_GT(std::abs(glm::dot(glm::normalize(glm::dquat(q)), glm::normalize(glm::dquat(expected)))), 1 - 1e-8);
    // One index an object, and its transform.
    const std::uint32_t id = view.object_id[i], index = record.opacity_object >> 8;
    ASSERT_LT(index, transforms.size());
    EXPECT_EQ(index_of.emplace(id, index).first->second, index) << id;
    const auto object = shown.scene().objects.find(id);
    const bool hidden = id != 0 && object == shown.scene().objects.end();
    const ObjectTransform transform = hidden || id == 0 ? ObjectTransform{} : object->second;
    const glm::vec3 mean(record.mean[0], record.mean[1], record.mean[2]), world = transform * mean;
    for (std::size_t k = 0; k < 3; ++k) {
      const float* row = &transforms[index][4 * k];
      EXPECT_NEAR(row[0] * mean.x + row[1] * mean.y + row[2] * mean.z + row[3],
                  hidden ? 0.0F : world[static_cast<int>(k)], 1e-4F);
    }
    if (hidden) continue;
    if (view.layout.appearance == Appearance::Transfer) {
      const glm::vec3 color = shade_transfer(view, i, light_in_object(shown.scene().light, transform));
      EXPECT_LE(largest(glm::abs(decoded(record.color) - color)), largest(color) / 500 + 1e-6F);
    } else {
      const glm::vec3 color = 0.5F + 0.28209479F * glm::vec3(float_at(11), float_at(12), float_at(13));
      EXPECT_LE(largest(glm::abs(decoded(record.color) - glm::max(color, glm::vec3(0)))), largest(color) / 500 + 1e-6F);
    }
  }
  EXPECT_EQ(used, view.count);
}

class DisplayRowsTest : public testing::Test {
 protected:
  void give(const std::vector<EncodedPacket>& packets) {
    test::send(packets, replica);
    test::send(packets, shown);
  }
  void give(const EncodedSnapshot& snapshot) {
    test::send(snapshot, replica);
    test::send(snapshot, shown);
  }
  Replica replica;
  ShownReplica shown;
  Gpu gpu{replica};
};

Light lamp(std::uint32_t id) {
  Light light{.sun_direction = glm::normalize(glm::vec3(1, 2, 0)), .sun_irradiance = {3, 2, 1}, .sources = {}};
  light.ambient_sh[0] = {0.5F, 0.6F, 0.7F};
  light.ambient_sh[2] = {0.2F, 0.1F, 0};
  light.sources.push_back({.id = id, .position = {0, 1, 0}, .intensity = {4, 0, 2}});
  return light;
}

TEST_F(DisplayRowsTest, AGpuThatFollowsShowsWhatTheRasteriserReads) {
  ToyServer server(11, 600);
  server.scene.objects[7] = ObjectTransform(Rigid{.translation = {0, 1, 0}});
  server.scene.light = lamp(3);
  server.change_scene();
  give(server.stream.snapshot());
  gpu.follow();
  expect_shows(gpu, shown);
  for (int tick = 0; tick < 12; ++tick) {
    server.train(0.03F);
    if (tick % 3 == 1) server.remove(40);
    if (tick % 3 == 2) server.insert(50);
    if (tick % 4 == 3) {
      server.scene.light.sun_direction = glm::normalize(glm::vec3(1, 2, tick));
      server.scene.objects[7].rigid.rotation = glm::angleAxis(0.1F * static_cast<float>(tick), glm::vec3(0, 1, 0));
      server.scene.objects[7].scale = 1.5F;
    }
    if (tick == 6) server.scene.objects[1].emissive = true;
    if (tick == 8) server.scene.objects.erase(7);
    if (tick == 9) server.scene.light.sources.clear();
    give(server.tick());
    gpu.follow(tick % 2 ? 37 : 10000);
    expect_shows(gpu, shown);
    if (testing::Test::HasFailure()) FAIL() << "tick " << tick;
  }
}

TEST_F(DisplayRowsTest, WhileASnapshotArrivesItsChunksShowAndTheirRowsStay) {
  ToyServer server(12, 900);
  const EncodedSnapshot snapshot = server.stream.snapshot();
  give(snapshot.head);
  ASSERT_GT(snapshot.chunks.size(), 2U);
  std::size_t before = 0;
  for (auto chunk = snapshot.chunks.rbegin(); chunk != snapshot.chunks.rend(); ++chunk) {  // in whatever order
    give(std::vector{*chunk});
    gpu.follow();
    EXPECT_EQ(gpu.uploaded, replica.count() - before);
    before = replica.count();
    expect_shows(gpu, shown);
  }
  give(snapshot.tail);
  gpu.follow();
  EXPECT_EQ(gpu.uploaded + gpu.recolored, 0U) << "that it is whole changes no Gaussian";
  server.remove(30);
  give(server.tick());
  gpu.follow();
  expect_shows(gpu, shown);
}

TEST_F(DisplayRowsTest, WhatIsUploadedIsWhatChanged) {
  ToyServer server(13, 2000);
  give(server.stream.snapshot());
  gpu.follow();
  EXPECT_EQ(gpu.uploaded, 2000U);
  EXPECT_EQ(gpu.recolored, 0U);
  gpu.follow();
  EXPECT_EQ(gpu.uploaded + gpu.recolored, 0U);
  server.remove(60);
  const auto gone = 2000 - server.model().count();
  give(server.tick());
  gpu.follow();
  EXPECT_EQ(gpu.uploaded, gone) << "though their successors' slots are others";
  server.insert(gone);
  give(server.tick());
  gpu.follow();
  EXPECT_EQ(gpu.uploaded, gone);
  EXPECT_EQ(gpu.rows().capacity(), 2000U) << "rows are used again";
  // A Gaussian that moves, and one that is lit otherwise.
  server.model().parameters[5] += 0.5F;
  server.model().visibility[17] = 0.5F;
  give(server.tick());
  gpu.follow();
  EXPECT_EQ(gpu.uploaded, 1U);
  EXPECT_EQ(gpu.recolored, 1U);
  expect_shows(gpu, shown);
  // The sun moves: colours, and no records. An object moves under it: not even those.
  server.scene.light.sun_irradiance = {1, 1, 1};
  give(server.tick());
  gpu.follow();
  EXPECT_EQ(gpu.uploaded, 0U);
  const std::size_t seen = gpu.recolored;  // those of object 7, which is not there, wait
  server.scene.objects[7].rigid.translation = {1, 0, 0};
  give(server.tick());
  gpu.follow();
  EXPECT_EQ(gpu.uploaded, 0U);
  const std::size_t appeared = gpu.recolored;  // lit for the first time
  EXPECT_GT(appeared, 0U);
  EXPECT_EQ(seen + appeared, 2000U);
  server.scene.objects[7].rigid.translation = {2, 0, 0};
  give(server.tick());
  gpu.follow();
  EXPECT_EQ(gpu.uploaded + gpu.recolored, 0U);
  server.scene.objects[7].rigid.rotation = glm::angleAxis(1.0F, glm::vec3(1, 0, 0));
  give(server.tick());
  gpu.follow();
  EXPECT_EQ(gpu.uploaded, 0U);
  EXPECT_EQ(gpu.recolored, appeared) << "it turns under the sun";
  expect_shows(gpu, shown);
}

TEST_F(DisplayRowsTest, AfterALossAllIsGivenAgain) {
  ToyServer server(14, 300);
  give(server.stream.snapshot());
  gpu.follow();
  gpu.memory.assign(gpu.memory.size(), {});
  gpu.rows().forget_taken();
  gpu.follow();
  EXPECT_EQ(gpu.uploaded, 300U);
  expect_shows(gpu, shown);
}

TEST_F(DisplayRowsTest, AnotherModelTakesTheRowsOver) {
  give(ToyServer(15, 700).stream.snapshot());
  gpu.follow();
  ToyServer next(16, 300, Appearance::Radiance, {}, 78);
  give(next.stream.snapshot());
  gpu.follow();
  EXPECT_EQ(gpu.rows().capacity(), 700U);
  expect_shows(gpu, shown);
  next.insert(500);
  give(next.tick());
  gpu.follow();
  EXPECT_EQ(gpu.rows().capacity(), 800U);
  expect_shows(gpu, shown);
}

TEST_F(DisplayRowsTest, TheFarFieldIsWhereAnEyeInTheOriginSeesIt) {
  ToyServer server(17, 100);
  for (std::uint32_t& id : server.model().object_id) id = kFarFieldFrame;
  server.scene.objects[kFarFieldFrame] = far_field();
  give(server.tick());
  give(server.stream.snapshot());
  gpu.follow();
  const std::uint32_t index = gpu.rows().far_field();
  ASSERT_NE(index, 0U);
  EXPECT_EQ(gpu.memory[0].opacity_object >> 8, index);
  const DisplayRows::Transform& t = gpu.rows().transforms().at(index);
  // The sphere's nearest point to it lies straight above its centre, 1000 m from whoever looks.
  const glm::vec3 top = kFarFieldCentre + glm::vec3(0, kFarFieldRadius, 0);
  EXPECT_NEAR(t[4] * top.x + t[5] * top.y + t[6] * top.z + t[7], kFarFieldDistance_m, 0.5F);
  EXPECT_NEAR(t[0] * top.x + t[1] * top.y + t[2] * top.z + t[3], 0, 0.5F);
}

}  // namespace
}  // namespace splatbus::stream

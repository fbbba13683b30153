#include "stream/gpu_rows.h"

#include <gtest/gtest.h>

#include <map>

#include "expectations.h"
#include "gaussians/player.h"
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
    std::vector<GpuRecord> records;
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
  [[nodiscard]] GpuRows& rows() { return rows_; }
  /// Rows that are not free.
  [[nodiscard]] std::size_t count() const {
    return static_cast<std::size_t>(
        std::ranges::count_if(memory, [](const GpuRecord& record) { return record != GpuRecord{}; }));
  }

  std::vector<GpuRecord> memory;
  std::size_t uploaded = 0, recolored = 0;

 private:
  GpuRows rows_;
};

/// Compares the GPU's memory with the floats that the rasteriser reads of another replica of the same packets.
void expect_shows(Gpu& gpu, ShownReplica& shown) {
  const GaussiansView view = shown.view();
  const auto& transforms = gpu.rows().transforms();
  std::map<std::uint32_t, std::uint32_t> index_of;  // of object ids
  std::size_t used = 0, free = 0;
  const auto is_shown = [&](std::uint32_t row) {
    return std::ranges::any_of(view.ranges,
                               [&](const IndexRange& r) { return row >= r.first && row < r.first + r.count; }) &&
           test::is_shown(view, row);
  };
  for (std::uint32_t i = 0; i < gpu.memory.size(); ++i) {
    const GpuRecord& record = gpu.memory[i];
    if (!is_shown(i)) {
      EXPECT_EQ(record, GpuRecord{}) << "row " << i << " is free";
      ++free;
      continue;
    }
    ++used;
    const auto float_at = [&](int channel) { return *view.at(channel, i); };
    for (int c = 0; c < 3; ++c) {
      EXPECT_EQ(record.mean[static_cast<std::size_t>(c)], float_at(c));
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
    glm::vec3 color = 0.5F + 0.28209479F * glm::vec3(float_at(11), float_at(12), float_at(13));
    if (view.layout.appearance == Appearance::Transfer) {
      color = shade_transfer(view, i, light_in_object(shown.scene().light, transform));
    }
    color = glm::max(color, glm::vec3(0));
    EXPECT_LE(largest(glm::abs(decoded(record.color) - color)), largest(color) / 500 + 1e-6F);
  }
  EXPECT_EQ(used, shown.count());
}

class GpuRowsTest : public testing::Test {
 protected:
  void give(const std::vector<EncodedPacket>& packets) {
    test::send(packets, replica);
    test::send(packets, shown);
  }
  void join(ToyServer& server) {
    test::join(server.stream, replica);
    test::join(server.stream, shown);
  }
  void tick(ToyServer& server) {
    give(server.tick());
    test::send_pages(server.stream, replica);
    test::send_pages(server.stream, shown);
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

TEST_F(GpuRowsTest, AGpuThatFollowsShowsWhatTheRasteriserReads) {
  ToyServer server(11, 600);
  server.scene.objects[7] = ObjectTransform(Rigid{.translation = {0, 1, 0}});
  server.scene.light = lamp(3);
  server.change_scene();
  join(server);
  gpu.follow();
  expect_shows(gpu, shown);
  for (int turn = 0; turn < 12; ++turn) {
    server.train(0.03F);
    if (turn % 3 == 1) server.remove(40);
    if (turn % 3 == 2) server.insert(50);
    if (turn % 4 == 3) {
      server.scene.light.sun_direction = glm::normalize(glm::vec3(1, 2, turn));
      server.scene.objects[7].rigid.rotation = glm::angleAxis(0.1F * static_cast<float>(turn), glm::vec3(0, 1, 0));
      server.scene.objects[7].scale = 1.5F;
    }
    if (turn == 6) server.scene.objects[1].emissive = true;
    if (turn == 8) server.scene.objects.erase(7);
    if (turn == 9) server.scene.light.sources.clear();
    tick(server);
    gpu.follow(turn % 2 ? 37 : 10000);
    expect_shows(gpu, shown);
    if (testing::Test::HasFailure()) FAIL() << "turn " << turn;
  }
}

TEST_F(GpuRowsTest, WhileAModelArrivesItsPartsShowAndTheirRowsStay) {
  ToyServer server(12, 2500);
  give({server.stream.layout_packet()});
  give({*server.stream.scene_packet()});
  std::vector<EncodedPacket> parts;
  for (const OfferedPage& page : *server.stream.offered()) {
    for (PagePacket& part : server.stream.page_packets(page.page, kBlockRows)) parts.push_back(std::move(part.packet));
  }
  ASSERT_GT(parts.size(), 5U);
  std::size_t before = 0;
  for (auto part = parts.rbegin(); part != parts.rend(); ++part) {  // in whatever order
    give({*part});
    gpu.follow();
    const std::size_t shows = gpu.count();
    EXPECT_EQ(gpu.uploaded, shows - before);
    before = shows;
  }
  EXPECT_EQ(before, 2500U);
  expect_shows(gpu, shown);
}

TEST_F(GpuRowsTest, WhatIsUploadedIsWhatChanged) {
  ToyServer server(13, 2000);
  join(server);
  gpu.follow();
  EXPECT_EQ(gpu.uploaded, 2000U);
  EXPECT_EQ(gpu.recolored, 0U);
  gpu.follow();
  EXPECT_EQ(gpu.uploaded + gpu.recolored, 0U);
  server.remove(60);
  const auto gone = 2000 - server.model().count();
  tick(server);
  gpu.follow();
  EXPECT_GE(gpu.uploaded, gone);
  EXPECT_LE(gpu.uploaded, 4 * gone) << "those that left, and those that fill their gaps";
  expect_shows(gpu, shown);
  server.insert(gone);
  tick(server);
  gpu.follow();
  EXPECT_EQ(gpu.uploaded, gone);
  // A Gaussian that grows, and one that is lit otherwise.
  server.model().parameters[3 * server.model().stride()] += 0.5F;
  server.model().visibility[17] = 0.5F;
  tick(server);
  gpu.follow();
  EXPECT_EQ(gpu.uploaded, 1U);
  EXPECT_EQ(gpu.recolored, 1U);
  expect_shows(gpu, shown);
  // The sun moves: colours, and no records. An object moves under it: not even those.
  server.scene.light.sun_irradiance = {1, 1, 1};
  tick(server);
  gpu.follow();
  EXPECT_EQ(gpu.uploaded, 0U);
  const std::size_t seen = gpu.recolored;  // those of object 7, which is not there, wait
  server.scene.objects[7].rigid.translation = {1, 0, 0};
  tick(server);
  gpu.follow();
  EXPECT_EQ(gpu.uploaded, 0U);
  const std::size_t appeared = gpu.recolored;  // lit for the first time
  EXPECT_GT(appeared, 0U);
  EXPECT_EQ(seen + appeared, 2000U);
  server.scene.objects[7].rigid.translation = {2, 0, 0};
  tick(server);
  gpu.follow();
  EXPECT_EQ(gpu.uploaded + gpu.recolored, 0U);
  server.scene.objects[7].rigid.rotation = glm::angleAxis(1.0F, glm::vec3(1, 0, 0));
  tick(server);
  gpu.follow();
  EXPECT_EQ(gpu.uploaded, 0U);
  EXPECT_EQ(gpu.recolored, appeared) << "it turns under the sun";
  expect_shows(gpu, shown);
}

TEST_F(GpuRowsTest, AfterALossAllIsGivenAgain) {
  ToyServer server(14, 300);
  join(server);
  gpu.follow();
  gpu.memory.assign(gpu.memory.size(), {});
  gpu.rows().forget_taken();
  gpu.follow();
  EXPECT_EQ(gpu.uploaded, gpu.memory.size());
  expect_shows(gpu, shown);
}

TEST_F(GpuRowsTest, AnotherModelTakesTheRowsOver) {
  ToyServer server(15, 1300);
  join(server);
  gpu.follow();
  const std::size_t capacity = gpu.rows().capacity();
  ToyServer next(16, 300, Appearance::Radiance, {}, 177);
  join(next);
  gpu.follow();
  EXPECT_EQ(gpu.rows().capacity(), capacity);
  expect_shows(gpu, shown);
  next.insert(1500);
  tick(next);
  gpu.follow();
  expect_shows(gpu, shown);
}

TEST_F(GpuRowsTest, TheFarFieldIsWhereAnEyeInTheOriginSeesIt) {
  ToyServer server(17, 100);
  for (std::uint32_t& id : server.model().object_id) id = kFarFieldFrame;
  server.scene.objects[kFarFieldFrame] = far_field();
  tick(server);
  tick(server);
  join(server);
  gpu.follow();
  const std::uint32_t index = gpu.rows().far_field();
  ASSERT_NE(index, 0U);
  EXPECT_EQ(gpu.memory[0].opacity_object >> 8, index);
  const GpuRows::Transform& t = gpu.rows().transforms().at(index);
  // The sphere's nearest point to it lies straight above its centre, 1000 m from whoever looks.
  const glm::vec3 top = kFarFieldCentre + glm::vec3(0, kFarFieldRadius, 0);
  EXPECT_NEAR(t[4] * top.x + t[5] * top.y + t[6] * top.z + t[7], kFarFieldDistance_m, 0.5F);
  EXPECT_NEAR(t[0] * top.x + t[1] * top.y + t[2] * top.z + t[3], 0, 0.5F);
}

TEST_F(GpuRowsTest, ThePlayersCameraIsAmongTheTransformsWhileThereIsOne) {
  ToyServer server(19, 100);
  join(server);
  gpu.follow();
  EXPECT_EQ(gpu.rows().player(), 0U);
  const glm::quat turn = glm::angleAxis(0.5F, glm::vec3(0, 1, 0));
  server.scene.objects[kPlayerId] = ObjectTransform(Rigid{.rotation = turn, .translation = {1, 2, 3}});
  tick(server);
  gpu.follow();
  const std::uint32_t index = gpu.rows().player();
  ASSERT_NE(index, 0U);
  const GpuRows::Transform& t = gpu.rows().transforms().at(index);
  const glm::vec3 forward = turn * glm::vec3(0, 0, 1);
  for (int k = 0; k < 3; ++k) {
    EXPECT_NEAR(t[static_cast<std::size_t>(4 * k + 2)], forward[k], 1e-3F);
    EXPECT_NEAR(t[static_cast<std::size_t>(4 * k + 3)], k + 1, 1e-3F);
  }
  server.scene.objects.erase(kPlayerId);
  tick(server);
  gpu.follow();
  EXPECT_EQ(gpu.rows().player(), 0U);
}

}  // namespace
}  // namespace splatbus::stream

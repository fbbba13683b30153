// One thread ticks, another takes scenes.
#include <gtest/gtest.h>

#include <atomic>
#include <random>
#include <thread>

#include "expectations.h"
#include "toy_server.h"

namespace splatbus::stream {
namespace {

TEST(TwoThreads, ScenesLeaveAmongThePacketsOfTicksAndAllOfThemFollowOnEachOther) {
  GaussiansBuffer model = test::toy_model(3000, 1);
  StreamModel stream(PacketWriter("streamer", 1), 77, {.chunk_gaussians = 256});
  ASSERT_TRUE(stream.observe(model.view()));
  stream.reset_to_target();
  test::ShownReplica replica;
  test::send(stream.snapshot(), replica);
  std::atomic<bool> done = false;
  std::thread ticking([&] {
    std::mt19937 random(3);
    std::normal_distribution<float> normal(0, 0.05F);
    for (int tick = 0; tick < 30; ++tick) {
      for (float& value : model.parameters) value += normal(random);
      for (int k = 0; k < 10; ++k) model.gaussian_id[random() % model.count()] = 10'000 + random() % 100'000;
      EXPECT_TRUE(stream.observe(model.view()));
      stream.make_tick(1e9, {});
    }
    done = true;
  });
  std::vector<EncodedPacket> packets;
  const auto take = [&](std::vector<EncodedPacket> more) {
    for (EncodedPacket& packet : more) packets.push_back(std::move(packet));
  };
  SceneState scene;
  std::size_t among = 0;
  while (!done || scene.version < 100) {
    ++scene.version;
    scene.objects[7].rigid.translation.x += 0.5F;
    scene.light.sources.resize(scene.version % 3);
    for (std::uint32_t k = 0; k < scene.light.sources.size(); ++k) scene.light.sources[k].id = k + 1;
    const std::uint64_t before = stream.status().sequence;
    auto more = stream.take_scene(scene, {});
    ASSERT_FALSE(more.empty());
    EXPECT_EQ(more.back().body, wire::Body::Scene);
    EXPECT_GT(more.back().sequence, before);
    if (!done) ++among;
    take(std::move(more));
  }
  ticking.join();
  take(stream.take_packets());
  EXPECT_GT(among, 1U);
  const std::uint64_t first = replica.held()->sequence + 1;
  for (std::size_t i = 0; i < packets.size(); ++i) ASSERT_EQ(packets[i].sequence, first + i);
  test::send(packets, replica);
  test::expect_exact(stream, replica);
  test::expect_shown(replica);
  EXPECT_EQ(replica.scene_version(), scene.version);
}

}  // namespace
}  // namespace splatbus::stream

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
  StreamModel stream(PacketWriter("streamer", 1), 77);
  ASSERT_TRUE(stream.observe(model.view()));
  stream.reset_to_target();
  test::ShownReplica replica;
  test::join(stream, replica);
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
  std::vector<EncodedPacket> scenes;
  std::vector<DeltaPacket> deltas;
  const auto take_deltas = [&] {
    for (DeltaPacket& delta : stream.take_update().deltas) deltas.push_back(std::move(delta));
  };
  SceneState scene;
  std::size_t among = 0;
  while (!done || scene.version < 100) {
    ++scene.version;
    scene.objects[7].rigid.translation.x += 0.5F;
    scene.light.sources.resize(scene.version % 3);
    for (std::uint32_t k = 0; k < scene.light.sources.size(); ++k) scene.light.sources[k].id = k + 1;
    auto packet = stream.take_scene(scene, {});
    ASSERT_TRUE(packet);
    scenes.push_back(std::move(*packet));
    take_deltas();
    // A page as it is at any moment is one of its versions.
    Replica other;
    test::join(stream, other);
    if (!done) ++among;
  }
  ticking.join();
  take_deltas();
  EXPECT_GT(among, 1U);
  EXPECT_GT(deltas.size(), 30U);
  for (const EncodedPacket& packet : scenes) replica.receive(test::parse(packet));
  for (const DeltaPacket& delta : deltas) replica.receive(test::parse(delta.packet));
  EXPECT_FALSE(replica.report().urgent());
  test::send_pages(stream, replica);
  test::expect_exact(stream, replica);
  test::expect_shown(replica);
  EXPECT_EQ(replica.scene_version(), scene.version);
}

}  // namespace
}  // namespace splatbus::stream

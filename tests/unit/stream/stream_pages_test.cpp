// What becomes of pages on their way: they change, split, grow, rest and end.
#include <gtest/gtest.h>

#include <limits>
#include <utility>

#include "../gaussians/paged_model.h"
#include "expectations.h"
#include "shown_replica.h"
#include "stream/stream_model.h"
#include "toy_server.h"

namespace splatbus::stream {
namespace {

using test::join;
using test::parse;
using test::send;
using test::ToyServer;

TEST(StreamPages, AStepSaysHowManyGaussiansThePageHasThen) {
  ToyServer server(22, 3000);
  server.remove(40);
  server.insert(100);
  server.train(0.05F);
  ASSERT_TRUE(server.stream.observe(server.model().view()));
  server.stream.make_tick(1e9, {});
  std::size_t structures = 0;
  for (const DeltaPacket& delta : server.stream.take_update().deltas) {
    for (const DeltaPacket::Step& step : delta.steps) {
      structures += step.other_lanes ? 1 : 0;
      EXPECT_EQ(step.count, server.stream.held().find(step.page)->count);
    }
  }
  EXPECT_GE(structures, 2U);
}

TEST(StreamPages, APageWhoseGaussiansAreAllOthersAndNotFiniteEnds) {
  ToyServer server(23, 1500);
  test::ShownReplica replica;
  join(server.stream, replica);
  for (std::size_t i = kPageLanes; i < server.model().count(); ++i) {
    server.model().gaussian_id[i] += 10'000;
    server.model().parameters[i] = std::numeric_limits<float>::quiet_NaN();
  }
  ASSERT_TRUE(server.stream.observe(server.model().view()));
  server.stream.make_tick(1e9, {});
  send(test::packets_of(server.stream), replica);
  EXPECT_EQ(replica.count(), std::size_t{kPageLanes});
  test::expect_exact(server.stream, replica);
}

// As the trainer splits one: its number is free then, and what was in it is in two new ones.
TEST(StreamPages, APageThatIsSplitTravelsAsItsLanes) {
  const GaussiansBuffer model = test::toy_model(1000, 3);
  splatbus::test::PagedModel paged(model.view(), 1024, 100);
  ASSERT_EQ(paged.ranges.size(), 2U) << "the world, and object 7";
  StreamModel stream(PacketWriter("streamer", 1), 5);
  ASSERT_TRUE(stream.observe(paged.view()));
  stream.reset_to_target();
  test::ShownReplica replica;
  join(stream, replica);
  const std::size_t whole = stream.page_packets(0)[0].packet.bytes();

  const std::uint32_t count = paged.ranges[0].count, low = count / 2;
  // Pages 2 and 3 have what page 0 had.
  const std::vector<float> before(paged.memory);
  paged.memory.resize(4 * paged.page_floats);
  const std::size_t rows = paged.page_floats / kPageLanes;
  for (std::size_t row = 0; row < rows; ++row) {
    const bool wide = row + 2 >= rows;  // ids: two rows of one array
    if (wide) continue;
    for (std::uint32_t lane = 0; lane < count; ++lane) {
      const std::size_t page = lane < low ? 2 : 3, to = lane < low ? lane : lane - low;
      paged.memory[page * paged.page_floats + row * kPageLanes + to] = before[row * kPageLanes + lane];
    }
  }
  const auto ids = [&](float* memory, std::size_t page) {
    return reinterpret_cast<std::uint64_t*>(memory + page * paged.page_floats + (rows - 2) * kPageLanes);
  };
  for (std::uint32_t lane = 0; lane < count; ++lane) {
    const std::size_t page = lane < low ? 2 : 3, to = lane < low ? lane : lane - low;
    ids(paged.memory.data(), page)[to] = ids(const_cast<float*>(before.data()), 0)[lane];
  }
  paged.ranges = {paged.ranges[1], {2 * kPageLanes, low, 0}, {3 * kPageLanes, count - low, 0}};
  ASSERT_TRUE(stream.observe(paged.view()));
  stream.make_tick(1e9, {});
  const auto packets = test::packets_of(stream);
  ASSERT_EQ(packets.size(), 1U);
  EXPECT_LT(packets[0].bytes(), 2000U);
  EXPECT_GT(whole, 10'000U);
  send(packets, replica);
  EXPECT_EQ(replica.held().pages.size(), 3U);
  EXPECT_FALSE(replica.held().find(0));
  EXPECT_EQ(replica.count(), 1000U);
  test::expect_exact(stream, replica);
  test::expect_shown(replica);
}

// Of a page in a place that is seen for the first time: more comes than a packet of its lanes may bring.
TEST(StreamPages, APageThatBecomesManyReachesViewersWhole) {
  constexpr std::size_t kFill = 960, kPages = 6, kKept = kFill / kPages;
  GaussiansBuffer one = test::toy_model(kFill, 3), many = test::toy_model(kFill * kPages, 4);
  std::ranges::fill(one.object_id, 0U);
  std::ranges::fill(many.object_id, 0U);
  for (std::size_t i = 0; i < many.count(); ++i) {
    const std::size_t page = i / kFill, lane = i % kFill;
    many.gaussian_id[i] = lane < kKept ? page * kKept + lane + 1 : 10'000 + i;
  }
  const splatbus::test::PagedModel before(one.view(), kFill, 100), after(many.view(), kFill, 100);
  ASSERT_EQ(before.ranges.size(), 1U);
  ASSERT_EQ(after.ranges.size(), kPages);
  StreamModel stream(PacketWriter("streamer", 1), 5);
  ASSERT_TRUE(stream.observe(before.view()));
  stream.reset_to_target();
  test::ShownReplica replica;
  join(stream, replica);
  for (int tick = 0; tick < 2; ++tick) {
    ASSERT_TRUE(stream.observe(after.view()));
    stream.make_tick(1e9, {});
    send(test::packets_of(stream), replica);
    test::send_pages(stream, replica);
  }
  EXPECT_EQ(replica.count(), kFill * kPages);
  test::expect_exact(stream, replica);
  test::expect_shown(replica);
}

TEST(StreamPages, AFrozenPagesBlobStaysAsItIsWhileOthersAndTheLightChange) {
  GaussiansBuffer model = test::toy_model(2000, 3);
  splatbus::test::PagedModel paged(model.view(), 600, 100);
  paged.ranges[0].frozen = 1;
  StreamModel stream(PacketWriter("streamer", 1), 5);
  ASSERT_TRUE(stream.observe(paged.view()));
  stream.reset_to_target();
  const auto blob = [&] {
    const auto packet = parse(stream.page_packets(0)[0].packet);
    const auto payload = packet.payload().first(packet.root().body_as_Page()->blob_bytes());
    return std::pair(packet.root().body_as_Page()->version(), Bytes(payload.begin(), payload.end()));
  };
  const auto first = blob();
  for (int tick = 0; tick < 40; ++tick) {
    for (std::size_t k = paged.page_floats; k < paged.page_floats + 600; ++k) paged.memory[k] += 0.01F;
    ASSERT_TRUE(stream.observe(paged.view()));
    stream.make_tick(1e9, {});
    const std::vector<std::uint32_t> sun{0};
    const std::vector<std::uint8_t> seen(paged.view().count, tick % 2 ? 0 : 255);
    (void)stream.take_visibility({.light_ids = sun, .of_index = seen, .scene_version = 1U + tick});
  }
  EXPECT_EQ(blob(), first);
  EXPECT_TRUE(stream.offered()->at(0).frozen);
  EXPECT_FALSE(stream.offered()->at(1).frozen);
  EXPECT_GT(stream.offered()->at(1).version, 40U);
}

TEST(StreamModel, AFrozenPageIsOfferedAsSuchOnceNothingOfItIsLeftToSend) {
  GaussiansBuffer model = test::toy_model(500, 3);
  splatbus::test::PagedModel paged(model.view(), 600, 100);
  StreamModel stream(PacketWriter("streamer", 1), 5);
  ASSERT_TRUE(stream.observe(paged.view()));
  stream.reset_to_target();
  stream.make_tick(1e9, {});
  for (std::size_t k = 0; k < 500; ++k) paged.memory[k] += 0.5F;
  paged.ranges[0].frozen = 1;
  for (int tick = 0; tick < 40; ++tick) {
    ASSERT_TRUE(stream.observe(paged.view()));
    stream.make_tick(0, {});
    ASSERT_FALSE(stream.offered()->at(0).frozen) << "and would be kept for good as it was";
  }
  for (int tick = 0; tick < 40; ++tick) stream.make_tick(1e9, {});
  EXPECT_TRUE(stream.offered()->at(0).frozen);
  const QuantizedGaussians& target = stream.observed_gaussians();
  const HeldPage& page = *stream.held().find(0);
  for (std::uint32_t lane = 0; lane < page.count; ++lane) {
    const std::uint64_t id = stream.held().gaussians.gaussian_id[page.row(lane)];
    const auto column = std::ranges::find(target.gaussian_id, id) - target.gaussian_id.begin();
    EXPECT_NEAR(stream.held().gaussians.channels[0][page.row(lane)], target.channels[0][column], 1);
  }
}

}  // namespace
}  // namespace splatbus::stream
